"""A map that keeps no images: each is removed once its view is described, and nothing else is."""

from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.errors import BadSnapshot, Conflict, Damaged, ImageNotKept, NotFound
from schemas.log_context import bound, fields
from schemas.map_changes import MapChanges
from schemas.records import ViewRecord
from tests.storage.carried import JOB, made, views
from tests.storage.conftest import Open
from tests.storage.material import NOW, RECIPE, describe_all, enroll, facts, finish, image, recipe
from worker.storage import damage, snapshot_portions
from worker.storage.examining import examine
from worker.storage.jobs import ATTEMPTS
from worker.storage.snapshot_portions import Portion, Portions
from worker.storage.snapshot_rows import WrittenView
from worker.storage.store import SqlStore
from worker.storage.tables import CELLS, MAPS


def files(data: Path) -> set[str]:
    """SHA-256 of the images that lie in a data folder."""
    return {path.name for path in data.glob("pictures/*/*/*")}


def digests(*names: str) -> set[str]:
    return {facts(image(name)).sha256 for name in names}


@pytest.fixture
def forgetful(store: SqlStore) -> SqlStore:
    """A map that keeps no images, with two described views."""
    store.maps.put("campus", RECIPE, NOW)
    assert store.maps.change("campus", MapChanges(keep_images=False)).keep_images is False
    enroll(store, "gate")
    enroll(store, "yard")
    describe_all(store)
    return store


def only_fog(store: SqlStore) -> None:
    """Have the map hold two views alone, which could not be described."""
    for view in views(store):
        store.removals.delete_view(view.id)
    for name in ("fog", "mist"):
        enroll(store, name)
        [claim] = store.jobs.claim("worker", 1)
        store.jobs.fail(claim, "nothing-static", f"only {name}", NOW)


def test_an_image_is_removed_once_its_view_is_described(store: SqlStore, data: Path) -> None:
    store.maps.put("campus", RECIPE, NOW)
    store.maps.change("campus", MapChanges(keep_images=False))
    view = enroll(store, "gate").view
    assert store.views.image(view.id) == image("gate")
    describe_all(store)
    assert files(data) == set()
    assert store.views.get(view.id).state == "ready"
    assert store.maps.counts("campus").image_bytes == 0
    with pytest.raises(ImageNotKept, match="keeps no images"):
        store.views.image(view.id)
    with pytest.raises(NotFound):
        store.views.image("0" * 36)


def test_images_that_are_there_go_at_once_and_those_that_are_needed_stay(store: SqlStore, data: Path) -> None:
    for name in ("gate", "yard", "shared"):
        enroll(store, name)
    enroll(store, "shared", map="other")
    describe_all(store)
    pending = enroll(store, "pending").view
    store.maps.change("campus", MapChanges(keep_images=False))
    assert files(data) == digests("shared", "pending")
    assert store.views.image(pending.id) == image("pending")
    describe_all(store)
    assert files(data) == digests("shared")


def test_what_could_not_be_described_keeps_its_image_until_it_is(forgetful: SqlStore, data: Path) -> None:
    view = enroll(forgetful, "fog").view
    [claim] = forgetful.jobs.claim("worker", 1)
    forgetful.jobs.fail(claim, "nothing-static", "only fog", NOW)
    assert files(data) == digests("fog")
    assert enroll(forgetful, "fog").view.id == view.id
    describe_all(forgetful)
    assert files(data) == set()


def test_the_same_image_again_is_its_view_and_leaves_no_file(forgetful: SqlStore, data: Path) -> None:
    again = enroll(forgetful, "gate")
    assert (again.created, again.view.state) == (False, "ready")
    assert files(data) == set()


def test_a_crash_in_between_is_made_good_at_the_next_start(store: SqlStore, data: Path, reopen: Open) -> None:
    enroll(store, "gate")
    describe_all(store)
    with store._database.writing() as connection:
        connection.execute(sa.update(MAPS).values(drop_images=True))
    assert files(data) == digests("gate")
    store.close()
    reopen().recover()
    assert files(data) == set()


def test_a_flipped_bit_costs_no_images(store: SqlStore, data: Path, reopen: Open) -> None:
    enroll(store, "gate")
    describe_all(store)
    with store._database.writing() as connection:
        connection.execute(sa.update(MAPS).values(drop_images=True, checksum=MAPS.c.checksum))
    store.close()
    damaged = reopen()
    damaged.recover()
    assert damaged.maps.get("campus").keep_images
    assert files(data) == digests("gate")


def test_doctor_misses_no_image_that_was_not_to_be_kept(forgetful: SqlStore, data: Path, database_url: str) -> None:
    view = enroll(forgetful, "pending").view
    forgetful.close()
    assert list(examine(database_url, data)) == []
    [path] = [path for path in data.glob("pictures/*/*/*") if path.name in digests("pending")]
    path.unlink()
    [found] = examine(database_url, data)
    assert view.id in found.what


def test_views_cannot_be_described_anew_nor_learned_from(forgetful: SqlStore) -> None:
    with pytest.raises(Conflict, match="keeps no images"):
        forgetful.jobs.switch_recipe("campus", recipe("other"), NOW)
    with pytest.raises(Conflict, match="keeps no images"):
        forgetful.jobs.queue_vocabulary("campus", NOW)
    assert forgetful.maps.get("campus").recipe == RECIPE
    assert forgetful.jobs.switch_recipe("campus", RECIPE, NOW).state == "done"
    forgetful.removals.delete_view(views(forgetful)[0].id)
    forgetful.removals.delete_view(views(forgetful)[0].id)
    assert forgetful.jobs.switch_recipe("campus", recipe("other"), NOW).state == "done"


def test_a_job_that_reads_images_is_waited_for(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    with pytest.raises(Conflict, match=job.id):
        store.maps.change("campus", MapChanges(keep_images=False))
    store.jobs.cancel(job.id, NOW)
    assert store.maps.change("campus", MapChanges(keep_images=False)).keep_images is False


def test_images_are_kept_again_only_while_none_is_gone(forgetful: SqlStore) -> None:
    assert forgetful.maps.change("campus", MapChanges(keep_images=False)).keep_images is False
    with pytest.raises(Conflict, match="images are gone"):
        forgetful.maps.change("campus", MapChanges(keep_images=True))
    for view in views(forgetful):
        forgetful.removals.delete_view(view.id)
    assert forgetful.maps.change("campus", MapChanges(keep_images=True)).keep_images
    with pytest.raises(NotFound):
        forgetful.maps.change("moon", MapChanges(keep_images=False))


def test_a_damaged_description_asks_for_the_image_again(forgetful: SqlStore) -> None:
    view: ViewRecord = views(forgetful)[0]
    with forgetful._database.writing() as connection:
        connection.execute(sa.update(CELLS).where(CELLS.c.seq == view.seq).values(body=b"damaged"))
    assert forgetful.descriptions.cells([view.seq], RECIPE.description.id) == {}
    with pytest.raises(Damaged, match="enrol the image again"):
        forgetful.views.image(view.id)
    assert enroll(forgetful, "gate").view.id == view.id
    describe_all(forgetful)
    assert forgetful.views.get(view.id).state == "ready"


def test_a_snapshot_carries_the_map_without_its_images(forgetful: SqlStore, elsewhere: SqlStore) -> None:
    forgetful.maps.change("campus", MapChanges(keep_queries=7))
    forgetful.maps.change("campus", MapChanges(keep_matches=8))
    forgetful.maps.change("campus", MapChanges(refuse_poor=True))
    pending = enroll(forgetful, "pending").view
    elsewhere.restoring.restore(made(forgetful), None, NOW)
    record = elsewhere.maps.get("campus")
    assert (record.keep_images, record.keep_queries, record.keep_matches) == (False, 7, 8)
    assert record.refuse_poor
    assert [view.id for view in views(elsewhere)] == [view.id for view in views(forgetful)]
    assert elsewhere.views.image(pending.id) == image("pending")
    describe_all(elsewhere)
    describe_all(forgetful)
    assert elsewhere.maps.counts("campus").image_bytes == 0
    for view in views(elsewhere):
        with pytest.raises(ImageNotKept):
            elsewhere.views.image(view.id)


def test_a_damaged_description_makes_no_snapshot_until_the_image_is_enrolled_again(
    forgetful: SqlStore, elsewhere: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, view = views(forgetful)
    with forgetful._database.writing() as connection:
        connection.execute(sa.update(CELLS).where(CELLS.c.seq == view.seq).values(body=b"damaged"))
    told_by: list[object] = []
    monkeypatch.setattr(damage.log, "error", lambda *_: told_by.append(fields().get("job_id")))
    with bound(job_id=JOB), pytest.raises(Damaged, match=f"the description of the view {view.id} is damaged"):
        made(forgetful)
    assert told_by == [JOB]
    assert not list((data / "snapshots").iterdir())
    assert forgetful.views.get(view.id).state == "failed"
    assert enroll(forgetful, "yard").view.id == view.id
    describe_all(forgetful)
    assert elsewhere.restoring.restore(made(forgetful), None, NOW).pending == 0


def test_a_snapshot_that_lacks_the_image_of_a_pending_view_is_refused(
    forgetful: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_images(self: object, seqs: object, views: list[WrittenView], without: object) -> Portion:
        return Portion(views)

    enroll(forgetful, "pending")
    monkeypatch.setattr(Portions, "_portion", without_images)  # as a file made by hand would be
    with pytest.raises(BadSnapshot, match="is missing"):
        elsewhere.restoring.restore(made(forgetful), None, NOW)
    assert elsewhere.maps.all() == []


def test_a_view_that_is_described_by_two_recipes_keeps_its_image_until_both_have(
    store: SqlStore, data: Path, elsewhere: SqlStore
) -> None:
    """One enrolled a moment before a recipe switch waits for the old recipe and for the new one."""
    store.maps.put("campus", RECIPE, NOW)
    store.maps.change("campus", MapChanges(keep_images=False))
    enroll(store, "gate")
    store.jobs.switch_recipe("campus", recipe("other"), NOW)
    yard = enroll(store, "yard").view
    left = []
    while claims := store.jobs.claim("worker", 1):
        assert store.views.image(claims[0].view.id) in (image("gate"), image("yard"))
        finish(store, claims[0])
        left.append(len(files(data)))
        elsewhere.restoring.restore(made(store), f"after-{len(left)}", NOW)  # as it is in between
    assert left == [2, 2, 1, 0]
    assert store.maps.get("campus").recipe == recipe("other")
    assert [view.state for view in views(store)] == ["ready", "ready"]
    with pytest.raises(ImageNotKept):
        store.views.image(yard.id)


def test_images_go_when_a_switch_ends_or_is_cancelled(forgetful: SqlStore, data: Path) -> None:
    only_fog(forgetful)
    job = forgetful.jobs.switch_recipe("campus", recipe("other"), NOW)
    enroll(forgetful, "fog")  # by the recipe in use, too
    [claim, *_] = forgetful.jobs.claim("worker", 1)
    finish(forgetful, claim)
    assert files(data) == digests("fog", "mist")
    forgetful.jobs.cancel(job.id, NOW)
    assert files(data) == digests("mist")

    forgetful.removals.delete_view(claim.view.id)
    enroll(forgetful, "haze")
    [claim] = forgetful.jobs.claim("worker", 1)
    forgetful.jobs.fail(claim, "nothing-static", "only haze", NOW)
    forgetful.jobs.switch_recipe("campus", recipe("other"), NOW)
    describe_all(forgetful)
    assert [view.state for view in views(forgetful)] == ["ready", "ready"]
    assert files(data) == set()


@pytest.mark.parametrize("ending", ["fails", "is cancelled", "is left by three workers", "goes with its view"])
def test_images_go_however_the_last_job_of_a_switch_ends(forgetful: SqlStore, data: Path, ending: str) -> None:
    only_fog(forgetful)
    forgetful.jobs.switch_recipe("campus", recipe("other"), NOW)
    [fog] = forgetful.jobs.claim("worker", 1)
    finish(forgetful, fog)
    assert files(data) == digests("fog", "mist")

    if ending == "fails":
        [mist] = forgetful.jobs.claim("worker", 1)
        forgetful.jobs.fail(mist, "nothing-static", "nothing but mist", NOW)
    elif ending == "is cancelled":
        [waiting] = forgetful.jobs.list("campus", kinds=["describe"], state="waiting")[0]
        forgetful.jobs.cancel(waiting.id, NOW)
    elif ending == "is left by three workers":
        for _ in range(ATTEMPTS):
            forgetful.jobs.claim("worker", 1)
            forgetful.workers.bury([], NOW)
    else:
        [mist] = forgetful.jobs.claim("worker", 1)
        forgetful.removals.delete_view(mist.view.id)

    assert forgetful.maps.get("campus").recipe == recipe("other")
    assert forgetful.views.get(fog.view.id).state == "ready"
    assert files(data) == (set() if ending == "goes with its view" else digests("mist"))


def test_a_snapshot_has_views_that_are_described_while_it_is_made(
    forgetful: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(snapshot_portions, "MOST_VIEWS", 1)  # so that the image of the last is not read ahead
    enroll(forgetful, "late")

    def meanwhile(done: int, total: int) -> None:
        describe_all(forgetful)

    record = forgetful.snapshots.make("campus", JOB, NOW, meanwhile)
    assert record.facts.views == 3
    with forgetful.snapshots.open(JOB) as file:
        restored = elsewhere.restoring.restore(Path(file.name), None, NOW)
    assert (restored.views, restored.pending) == (3, 0)
    assert [view.state for view in views(elsewhere)] == ["ready"] * 3
