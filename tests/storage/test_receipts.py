"""What a deletion says: what is gone from where, and which snapshots still have it."""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import sqlalchemy as sa

from app.http.examples import VIEW
from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from schemas.records import Filters, Position, Replay, ViewAttributes
from schemas.removal import Holding
from schemas.wire import Enrolled, EnrolledMany
from schemas.wire_views import rfc3339
from tests.answers import enrolled
from tests.storage.carried import made, views
from tests.storage.material import NOW, RECIPE, describe_all, description, enroll, image, recipe
from worker.storage.answers import SINCE_CHANGED
from worker.storage.image_files import Discarded
from worker.storage.store import SqlStore
from worker.storage.tables import CALLS

SECOND = "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b91"
THIRD = "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b92"


def quiet(done: int, total: int) -> None: ...


@pytest.fixture
def campus(store: SqlStore) -> SqlStore:
    """Three described views, one of whose images another map has too, and a pending one."""
    for name in ("gate", "yard", "hall"):
        has = ViewAttributes("east" if name != "hall" else "west", Position(x=0.5), NOW, filename="secret.jpg")
        enroll(store, name, attributes=has)
    enroll(store, "gate", map="other")
    describe_all(store)
    return store


def test_what_is_gone_from_where(campus: SqlStore) -> None:
    campus.jobs.switch_recipe("campus", recipe("next"), NOW)
    describe_all(campus)  # the descriptions by the recipe of before are kept for the way back
    campus.maps.change("campus", MapChanges(keep_matches=5))
    seq = views(campus)[0].seq
    by = campus.maps.get("campus").description
    for name in ("a", "b"):
        campus.kept_queries.keep("campus", QueryToKeep(name, by, description(1), image(name), NOW, (seq, 0.5)))
    enroll(campus, "pending", attributes=ViewAttributes("east"))

    receipt = campus.removals.delete_views("campus", Filters(place="east"))

    assert (receipt.views, receipt.descriptions, receipt.searched, receipt.queries) == (3, 4, 2, 2)
    assert (receipt.images, receipt.images_shared) == (2, 1)
    assert receipt.revision == campus.maps.revision("campus")
    assert receipt.snapshots == ()
    assert campus.kept_queries.newest("campus", 5, matched=True)[1] == 0


def answered(store: SqlStore, key: str, *views: str) -> None:
    """An enrolment of some images, with an Idempotency-Key, the last of which is like the first."""
    store.calls.begin(key, "print", NOW)
    store.calls.end(key, answer(store, *views), NOW)


def answer(store: SqlStore, *views: str) -> Replay:
    """The answer to an enrolment of some images, the last of which is like the first."""
    several = [enrolled() | {"view": told(store, one), "warnings": []} for one in views]
    like = f"it is like {several[0]['view']['place']!r} (view {views[0]})"
    several[-1]["warnings"] = [{"code": "duplicate", "detail": like, "view": views[0]}]
    body = several[0] if len(views) == 1 else {"views": several, "errors": [], "revision": 1, "timing_ms": {}}
    return Replay(201, {}, json.dumps(body).encode())


def told(store: SqlStore, view_id: str) -> dict[str, Any]:
    """What an answer tells of a view."""
    has = store.views.get(view_id).attributes
    return VIEW | {
        "id": view_id,
        "place": has.place,
        "position": asdict(has.position),
        "captured_at": None if has.captured_at is None else rfc3339(has.captured_at),
        "metadata": dict(has.metadata),
        "filename": has.filename,
    }


def test_what_was_told_of_a_deleted_view_is_not_repeated(campus: SqlStore) -> None:
    gate, yard, hall = (view.id for view in views(campus))
    for key, those in (("one", [gate]), ("two", [yard, gate]), ("other", [hall])):
        answered(campus, key, *those)

    campus.removals.delete_view(gate)

    one, two, other = (repeated(campus, key) for key in ("one", "two", "other"))
    assert (one.view.id, one.view.place, one.view.metadata, one.view.description) == (gate, None, {}, None)
    assert "secret" in two.model_dump_json()
    assert two.views[1].view.filename is two.views[1].view.position is None
    assert two.views[1].warnings[0].view == yard  # which is still there
    assert other.view.filename == "secret.jpg"
    campus.removals.delete_map("campus")
    for key in ("one", "two", "other"):
        left = repeated(campus, key).model_dump_json()
        assert "secret" not in left
        assert VIEW["image"]["sha256"] not in left
        assert "east" not in left
        assert "west" not in left
        assert "0.5" not in left
        assert rfc3339(NOW) not in left


def repeated(store: SqlStore, key: str) -> Any:
    """What a call with this key is answered again."""
    replay = store.calls.begin(key, "print", NOW)
    assert replay is not None
    assert replay.status == 201
    body = json.loads(replay.body)
    return (EnrolledMany if "views" in body else Enrolled).model_validate(body)


def test_answers_that_are_kept_tell_a_changed_view_as_it_is_now(campus: SqlStore) -> None:
    gate, yard, _ = views(campus)
    answered(campus, "one", gate.id)
    answered(campus, "two", gate.id, yard.id)
    before = repeated(campus, "two")

    position = Position(x=1.5, y=0.0, heading=90)
    campus.views.change(gate.id, lambda _: ViewAttributes("porch", position, NOW, {"run": 1}))

    one, two = repeated(campus, "one"), repeated(campus, "two")
    for told in (one.view, two.views[0].view):
        assert (told.place, told.captured_at, told.metadata, told.filename) == ("porch", NOW, {"run": 1}, None)
        assert told.position.model_dump(exclude_none=True) == {"x": 1.5, "y": 0.0, "heading": 90.0}
        assert told.image == before.views[0].view.image
    assert two.views[1].view == before.views[1].view
    assert [warning.detail for warning in one.warnings + two.views[1].warnings] == [SINCE_CHANGED] * 2


def test_answers_that_are_kept_stay_where_a_change_takes_nothing_away(campus: SqlStore) -> None:
    gate = views(campus)[0]
    answered(campus, "one", gate.id)
    before = repeated(campus, "one")
    campus.views.change(gate.id, lambda had: replace(had, metadata={"run": 1}))
    assert repeated(campus, "one") == before


def test_answers_of_calls_go_after_a_day_also_where_nobody_calls(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.calls.begin("key", "print", NOW)
    monkeypatch.setattr(store.calls, "_expires_at", 0)
    store.tend()  # today is later
    with store._database.reading() as connection:
        assert list(connection.execute(sa.select(CALLS.c.key))) == []


def test_snapshots_that_still_have_it_are_named_newest_first(campus: SqlStore) -> None:
    campus.snapshots.make("campus", SECOND, NOW, quiet)
    gate, yard, hall = views(campus)
    campus.removals.delete_view(hall.id)
    campus.snapshots.make("other", THIRD, NOW.replace(hour=13), quiet)

    assert [one.id for one in campus.removals.delete_view(yard.id).snapshots] == [SECOND]
    receipt = campus.removals.delete_view(gate.id)
    assert receipt.snapshots == (
        Holding(THIRD, "other", NOW.replace(hour=13), 1),
        Holding(SECOND, "campus", NOW, 1),
    )
    campus.snapshots.delete(THIRD)
    whole = campus.removals.delete_map("other")
    assert [(one.id, one.views) for one in whole.snapshots] == [(SECOND, 1)]


def test_a_view_of_later_is_in_no_snapshot_of_before(campus: SqlStore) -> None:
    campus.snapshots.make("campus", SECOND, NOW, quiet)
    later = enroll(campus, "later").view
    describe_all(campus)
    assert campus.removals.delete_view(later.id).snapshots == ()


def test_a_restored_view_is_found_in_the_snapshot_though_it_has_another_id(campus: SqlStore) -> None:
    campus.snapshots.make("campus", SECOND, NOW, quiet)
    with campus.snapshots.open(SECOND) as file:
        restored = campus.restoring.restore(Path(file.name), "copy", NOW)
    assert restored.new_ids
    receipt = campus.removals.delete_map("copy")
    assert [(one.id, one.views) for one in receipt.snapshots] == [(SECOND, 3)]
    assert (receipt.views, receipt.images, receipt.images_shared) == (3, 0, 3)


def test_a_snapshot_without_images_has_the_descriptions(campus: SqlStore) -> None:
    campus.maps.change("campus", MapChanges(keep_images=False))
    campus.snapshots.make("campus", SECOND, NOW, quiet)
    receipt = campus.removals.delete_views("campus", Filters(place="east"))
    assert [(one.id, one.views) for one in receipt.snapshots] == [(SECOND, 2)]
    assert receipt.images_shared == 1


def test_each_of_many_snapshots_is_read_once_for_all_deletions(
    campus: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = [SECOND[:-2] + f"{number:02}" for number in range(20)]
    for snapshot_id in many:
        campus.snapshots.make("campus", snapshot_id, NOW, quiet)
    place = campus.snapshots._place
    read = Mock(side_effect=place.digests)
    monkeypatch.setattr(place, "digests", read)

    for view in views(campus)[:2]:
        receipt = campus.removals.delete_view(view.id)
        assert [one.views for one in receipt.snapshots] == [1] * len(many)
    assert read.call_count == len(many)
    campus.snapshots.delete(many.pop())
    campus.snapshots.make("campus", many[0], NOW, quiet)  # anew, without those two
    [hall] = views(campus)
    assert [one.views for one in campus.removals.delete_view(hall.id).snapshots] == [1] * len(many)
    assert read.call_count == 20 + 1


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "another"])
def test_a_snapshot_that_cannot_be_read_stops_no_deletion(campus: SqlStore, data: Path, damage: str) -> None:
    campus.snapshots.make("campus", SECOND, NOW, quiet)
    path = data / "snapshots" / f"{SECOND}.snapshot"
    body = path.read_bytes()
    damaged = {"cut": body[:2000], "flipped": b"\xff" + body[1:], "empty": b"", "another": b"PK" * 600}
    path.write_bytes(damaged[damage])
    view = views(campus)[0]
    assert campus.removals.delete_view(view.id).snapshots == (Holding(SECOND, None, None, None),)
    assert len(views(campus)) == 2


def test_one_that_is_being_made_is_named_until_it_is_there(campus: SqlStore) -> None:
    job = campus.jobs.queue_snapshot("campus", NOW)
    gate, yard, _ = views(campus)
    assert campus.removals.delete_view(gate.id).snapshots == (), "one that has not begun will not have it"
    claim = campus.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    assert campus.removals.delete_view(yard.id).snapshots == (Holding(job.id, None, None, None),)


def test_the_receipt_of_a_map_counts_what_it_had(campus: SqlStore) -> None:
    campus.maps.change("campus", MapChanges(keep_queries=5))
    campus.kept_queries.keep("campus", QueryToKeep("q", RECIPE.description, description(1), image("q"), NOW))
    made(campus)
    receipt = campus.removals.delete_map("campus")
    assert (receipt.views, receipt.descriptions, receipt.searched, receipt.queries) == (3, 3, 3, 1)
    assert (receipt.images, receipt.images_shared, receipt.revision) == (2, 1, None)
    assert [one.views for one in receipt.snapshots] == [3]


def test_a_snapshot_that_begins_just_before_the_deletion_is_named(
    campus: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is looked for in the deletion's own transaction: what is claimed before it has what is deleted."""
    job = campus.jobs.queue_snapshot("campus", NOW)
    gate, _, _ = views(campus)
    freeing = campus.removals._database.freeing

    def claimed_first(work: Callable[[sa.Connection], object]) -> object:
        campus.jobs.claim_map_job("worker", NOW)
        return freeing(work)

    with monkeypatch.context() as patched:
        patched.setattr(campus.removals._database, "freeing", claimed_first)
        receipt = campus.removals.delete_view(gate.id)
    assert receipt.snapshots == (Holding(job.id, None, None, None),)


def test_a_snapshot_that_is_kept_while_its_map_is_deleted_is_named(
    campus: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was written whole, and gets its name when the receipt has looked for it."""
    job = campus.jobs.queue_snapshot("campus", NOW)
    assert campus.jobs.claim_map_job("worker", NOW) is not None
    keep = campus.snapshots._place.keep
    receipts = []

    def deleted_first(draft: Path, snapshot_id: str, tell: Callable[[], None]) -> None:
        receipts.append(campus.removals.delete_map("campus"))
        keep(draft, snapshot_id, tell)

    monkeypatch.setattr(campus.snapshots._place, "keep", deleted_first)
    campus.snapshots.make("campus", job.id, NOW, quiet)

    (receipt,) = receipts
    assert receipt.snapshots == (Holding(job.id, None, None, None),)
    assert campus.snapshots.get(job.id).facts.views == receipt.views == 3
    campus.snapshots.delete(job.id)


def test_an_image_is_told_as_it_was_when_it_was_removed_or_kept(
    campus: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever enrols or deletes it a moment later has answers of their own; each image is in one of both counts."""
    gate, yard, _ = views(campus)
    discard = campus.removals._images.discard

    def enrolled_again(digests: Iterable[str]) -> Discarded:
        done = discard(digests)
        enroll(campus, "yard", map="other")
        return done

    def deleted_too(digests: Iterable[str]) -> Discarded:
        done = discard(digests)
        monkeypatch.setattr(campus.removals._images, "discard", discard)
        campus.removals.delete_map("other")
        return done

    monkeypatch.setattr(campus.removals._images, "discard", enrolled_again)
    receipt = campus.removals.delete_view(yard.id)
    assert (receipt.images, receipt.images_shared) == (1, 0)
    monkeypatch.setattr(campus.removals._images, "discard", deleted_too)
    receipt = campus.removals.delete_view(gate.id)
    assert (receipt.images, receipt.images_shared) == (0, 1)
