"""A snapshot gives the same map back, on either database, as of one moment."""

import os
import subprocess
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import pytest
import sqlalchemy as sa
from hypothesis import given, strategies as st

from schemas.errors import Conflict, Damaged, NotFound, StorageFailed
from schemas.records import Filters, MapClaim, ViewAttributes
from tests.storage.carried import JOB, contents, filled, made, views
from tests.storage.databases import data_folder, postgres_schema
from tests.storage.material import NOW, describe_all, enroll, image
from worker.service.snapshots import SnapshotService
from worker.storage import snapshot_portions
from worker.storage.retrying import RolledBack
from worker.storage.snapshot_files import SnapshotReader
from worker.storage.snapshot_portions import MOST_BYTES, MOST_VIEWS, Portions, SizedView, portions
from worker.storage.store import SqlStore, open_store


def service_of(store: SqlStore) -> SnapshotService:
    """What makes the snapshots of a store."""
    return SnapshotService(
        files=store.snapshots,
        restorer=store.restoring,
        jobs=store.jobs,
        wake=lambda: None,
        rest=lambda seconds: None,
    )


def begun(store: SqlStore) -> tuple[SnapshotService, str, MapClaim]:
    """A job that makes a snapshot of a map with five views, as a worker has claimed it."""
    filled(store)
    service = service_of(store)
    job = service.queue("campus").id
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    return service, job, claim


def test_the_same_map_on_another_machine(store: SqlStore, elsewhere: SqlStore) -> None:
    filled(store)
    restored = elsewhere.restoring.restore(made(store), None, NOW)

    assert contents(elsewhere) == contents(store)
    assert [view.id for view in views(elsewhere)] == [view.id for view in views(store)]
    assert (restored.views, restored.pending, restored.new_ids) == (5, 1, False)
    assert elsewhere.comparisons.uncompared(100, 10) is None, "verdicts would change once it is compared anew"
    there, here = (one.comparisons.levels("campus") for one in (elsewhere, store))
    assert replace(there, revision=here.revision) == here
    assert describe_all(elsewhere) == 1
    assert elsewhere.listings.select("campus", Filters(metadata={"floor": "1"})).only is not None


def test_a_map_carried_from_sqlite_to_this_database_and_back(store: SqlStore, elsewhere: SqlStore) -> None:
    filled(elsewhere)
    store.restoring.restore(made(elsewhere), "carried", NOW)
    assert contents(store, "carried") == contents(elsewhere)

    elsewhere.restoring.restore(made(store, "carried"), "returned", NOW)
    assert contents(elsewhere, "returned") == contents(elsewhere)


def test_beside_the_map_itself_the_views_get_new_ids(store: SqlStore) -> None:
    filled(store)
    restored = store.restoring.restore(made(store), "copy", NOW)

    assert restored.new_ids
    assert contents(store, "copy") == contents(store)
    ids = [view.id for view in views(store, "copy")]
    assert ids == sorted(set(ids))
    assert not set(ids) & {view.id for view in views(store)}
    store.removals.delete_map("campus")
    assert store.views.image(ids[0]) == image("view 0")


def test_newer_enrolments_stay_newer_than_what_was_restored(store: SqlStore, elsewhere: SqlStore) -> None:
    filled(store)
    elsewhere.restoring.restore(made(store), None, NOW)
    later = enroll(elsewhere, "later", now=NOW).view

    assert views(elsewhere)[-1].id == later.id
    assert later.id > views(elsewhere)[-2].id
    assert elsewhere.listings.select("campus", Filters(exclude_last=1)).never.tolist() == [later.seq]


def test_any_tar_program_can_look_into_it(store: SqlStore) -> None:
    filled(store)
    listed = subprocess.run(["tar", "-tf", made(store)], capture_output=True, text=True, check=True).stdout.split()

    assert listed[0] == "snapshot.json"
    assert listed[-2:] == ["manifest.ndjson", "manifest.sha256"]
    assert sum(name.startswith("images/") for name in listed) == 5


def test_it_is_made_and_restored_where_nothing_but_the_data_folder_can_be_written(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container whose root is read-only and that has no /tmp."""

    def none() -> NoReturn:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile._get_default_tempdir", none)
    monkeypatch.setattr("tempfile.tempdir", None)
    filled(store)
    elsewhere.restoring.restore(made(store), None, NOW)
    assert contents(elsewhere) == contents(store)


def test_a_system_that_writes_a_part_of_what_it_is_given_gets_the_rest(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(store)
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, rest: write(file, rest[:30_000]))

    path = made(store)
    monkeypatch.undo()
    elsewhere.restoring.restore(path, None, NOW)
    assert contents(elsewhere) == contents(store)


def test_text_with_every_kind_of_line_end_comes_back_as_it_was(store: SqlStore, elsewhere: SqlStore) -> None:
    odd = "a\u2028b\r\nc\u0085d\x0b\u00e9"
    enroll(store, "gate", attributes=ViewAttributes(metadata={odd: [odd, 1e-7, -0.0, None]}))

    elsewhere.restoring.restore(made(store), None, NOW)
    assert [view.attributes.metadata for view in views(elsewhere)] == [{odd: [odd, 1e-7, -0.0, None]}]


def test_it_is_the_map_of_one_moment_while_the_service_works(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(snapshot_portions, "MOST_VIEWS", 8)
    filled(store, 80)
    before = [view.id for view in views(store)]
    gone = before[-30]

    def meanwhile(done: int, total: int) -> None:
        if done == 0:
            enroll(store, "meanwhile")
            store.views.change(before[1], lambda _: ViewAttributes(place="moved"))
            store.removals.delete_view(before[0])
        elif done == 32:
            store.removals.delete_view(gone)
            store.removals.delete_views("other", Filters())

    record = store.snapshots.make("campus", JOB, NOW, meanwhile)
    with store.snapshots.open(JOB) as file:
        elsewhere.restoring.restore(Path(file.name), None, NOW)

    after = views(elsewhere)
    assert [view.id for view in after] == [one for one in before if one != gone]
    assert after[1].attributes.place == "place 1"
    assert record.facts.views == len(after) == len(before) - 1


def test_a_damaged_image_makes_no_snapshot_and_a_damaged_description_is_made_anew(
    store: SqlStore, elsewhere: SqlStore, data: Path
) -> None:
    filled(store)
    with store._database.engine.begin() as connection:
        connection.execute(sa.text("UPDATE cells SET checksum = 7 WHERE seq = (SELECT min(seq) FROM cells)"))
    restored = elsewhere.restoring.restore(made(store), None, NOW)
    assert (restored.views, restored.pending) == (5, 2)

    digest = views(store)[1].image.sha256
    (data / "pictures" / digest[:2] / digest[2:4] / digest).write_bytes(b"damaged")
    with pytest.raises(Damaged):
        made(store)
    assert [path.name for path in (data / "snapshots").iterdir()] == [f"{JOB}.snapshot"]


def test_a_snapshot_of_version_1_is_restored_like_one_made_now(store: SqlStore, elsewhere: SqlStore) -> None:
    old = Path(__file__).with_name("version-1.snapshot")
    assert SnapshotReader(old).facts().version == 1
    filled(store)

    restored = elsewhere.restoring.restore(old, None, NOW)

    assert (restored.views, restored.pending) == (5, 1)
    assert contents(elsewhere) == contents(store)


@given(st.lists(st.integers(1, 3 * MOST_BYTES), max_size=300))
def test_portions_are_all_views_in_order_and_none_is_too_large(sizes: list[int]) -> None:
    cut = list(portions([SizedView(seq, size) for seq, size in enumerate(sizes)]))

    assert [seq for portion in cut for seq in portion] == list(range(len(sizes)))
    assert all(1 <= len(portion) <= MOST_VIEWS for portion in cut)
    assert all(len(portion) == 1 or sum(sizes[seq] for seq in portion) <= MOST_BYTES for portion in cut)


def test_snapshots_are_listed_and_deleted_and_leftovers_swept(store: SqlStore, data: Path) -> None:
    filled(store)
    made(store)
    (data / "snapshots" / ".writing-gone").touch()
    store.snapshots.receiving("x").touch()

    store.recover()

    [record] = store.snapshots.all()
    assert (record.facts.map, record.facts.views, record.facts.revision) == ("campus", 5, store.maps.revision("campus"))
    assert [path.name for path in (data / "snapshots").iterdir()] == [f"{JOB}.snapshot"]
    store.snapshots.delete(JOB)
    for missing in (JOB, "../../revisit.db", "x"):
        with pytest.raises(NotFound):
            store.snapshots.get(missing)


def test_from_postgresql_to_sqlite(elsewhere: SqlStore) -> None:
    with postgres_schema() as url, data_folder() as folder, closing(open_store(url, folder)) as server:
        filled(server)
        elsewhere.restoring.restore(made(server), None, NOW)
        assert contents(elsewhere) == contents(server)


@pytest.mark.parametrize("end", ["cancelled", "deleted", "stopped", "done"])
def test_a_job_makes_it_and_what_ends_the_job_leaves_no_file(store: SqlStore, data: Path, end: str) -> None:
    filled(store)
    service = service_of(store)
    queued = service.queue("campus")
    with pytest.raises(Conflict, match=queued.id):
        service.queue("campus")
    assert store.jobs.queue_vocabulary("campus", NOW).state == "waiting"  # which a snapshot does not hinder
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    assert (claim.kind, claim.job_id) == ("snapshot", queued.id)
    if end == "cancelled":
        store.jobs.cancel(queued.id, NOW)
    elif end == "deleted":
        store.removals.delete_map("campus")

    service.run(claim, lambda: end == "stopped")

    files = [path.name for path in (data / "snapshots").iterdir()]
    if end != "done":
        assert files == []
    if end in ("cancelled", "stopped"):
        assert store.jobs.get(queued.id).state == {"cancelled": "cancelled", "stopped": "waiting"}[end]
    elif end == "done":
        job = store.jobs.get(queued.id)
        assert (job.state, job.result and job.result["views"]) == ("done", 5)
        assert files == [f"{queued.id}.snapshot"]


@pytest.mark.parametrize("rest", ["done", "running"])
def test_who_was_silent_too_long_leaves_the_snapshot_to_whoever_took_it_up(
    store: SqlStore, data: Path, rest: str
) -> None:
    """As a worker that is stopped (SIGSTOP) while it writes, and goes on once another has the job."""
    filled(store)
    service = service_of(store)
    job = service.queue("campus").id
    slow = store.jobs.claim_map_job("slow", NOW)
    assert slow is not None
    making: list[Path] = []

    def stands_still() -> bool:
        if not making:  # in the middle of its file
            making.extend((data / "snapshots").glob(".writing-*"))
            store.workers.bury(["slow"], NOW)
            claim = store.jobs.claim_map_job("quick", NOW)
            assert claim is not None
            if rest == "done":
                service.run(claim, lambda: False)
        return False

    service.run(slow, stands_still)

    assert len(making) == 1
    assert store.jobs.get(job).state == rest
    if rest == "running":
        assert store.snapshots.all() == []
    else:
        [kept] = store.snapshots.all()
        copy = store.restoring.restore(data / "snapshots" / f"{kept.facts.id}.snapshot", "copy", NOW)
        assert copy.views == 5
    assert list((data / "snapshots").glob(".writing-*")) == []


def test_a_job_whose_end_could_not_be_stored_leaves_no_snapshot(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, job, claim = begun(store)

    def away(*_: object) -> NoReturn:
        raise StorageFailed("away")

    monkeypatch.setattr(store.jobs, "finish_snapshot", away)
    service.run(claim, lambda: False)
    assert store.jobs.get(job).state == "failed"
    assert store.snapshots.all() == []


def test_one_that_is_deleted_while_they_are_listed_is_told_as_no_error(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    filled(store)
    store.snapshots.make("campus", JOB, NOW, lambda *_: None)
    ids = store.snapshots._place.ids

    def deleted_then() -> list[str]:
        named = list(ids())
        store.snapshots.delete(JOB)
        return named

    monkeypatch.setattr(store.snapshots._place, "ids", deleted_then)
    assert store.snapshots.all() == []
    assert caplog.records == []


def test_a_file_of_another_name_is_told(store: SqlStore, data: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As one that somebody copied there: no call could name it."""
    filled(store)
    store.snapshots.make("campus", JOB, NOW, lambda *_: None)
    (data / "snapshots" / f"{JOB}.snapshot").rename(data / "snapshots" / "campus.snapshot")
    assert store.snapshots.all() == []
    assert "snapshot campus is left out of the list" in caplog.text


@pytest.mark.parametrize("when", ["while it is read", "while it is told", "before its end", "at its end"])
def test_a_snapshot_is_begun_anew_where_the_database_is_away_for_a_moment(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    """As while PostgreSQL is started again, which cuts the transaction that reads the map."""
    service, job, claim = begun(store)
    owner, name = {
        "while it is read": (Portions, "all"),
        "while it is told": (store.jobs, "report"),
        "before its end": (store.jobs, "finish_snapshot"),
        "at its end": (store.jobs, "finish_snapshot"),
    }[when]
    usual = getattr(owner, name)
    failed: list[str] = []

    def away_once(*given: Any) -> Any:
        if not failed:
            failed.append(when)
            if when == "at its end":  # nobody learned that it was stored
                usual(*given)
            raise RolledBack("away")
        return usual(*given)

    monkeypatch.setattr(owner, name, away_once)
    service.run(claim, lambda: False)

    assert failed == [when]
    ended = store.jobs.get(job)
    assert (ended.state, ended.result and ended.result["views"]) == ("done", 5)
    assert [path.name for path in (data / "snapshots").iterdir()] == [f"{job}.snapshot"]
    assert store.restoring.restore(data / "snapshots" / f"{job}.snapshot", "copy", NOW).views == 5


def test_a_worker_that_stops_while_the_database_is_away_puts_the_job_back(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    service, job, claim = begun(store)
    tried: list[int] = []

    def away(*_: object) -> NoReturn:
        tried.append(1)
        raise RolledBack("away")

    monkeypatch.setattr(Portions, "all", away)
    service.run(claim, lambda: len(tried) == 2)

    assert (len(tried), store.jobs.get(job).state) == (2, "waiting")
