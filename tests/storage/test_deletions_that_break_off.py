"""The deletion of a map that breaks off is finished without a new start: no call finds the map any more."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import sqlalchemy as sa
import time_machine

from schemas.errors import NotFound, StorageFailed
from schemas.map_changes import MapChanges
from schemas.records import Filters
from schemas.snapshot import RestoredMap
from tests.storage.carried import JOB, filled, made
from tests.storage.material import NOW, RECIPE, describe_all, enroll
from tests.waiting import until
from worker.service.maps import MapService
from worker.storage import clock, removals
from worker.storage.answers import StoredAnswers
from worker.storage.database import Database
from worker.storage.removals import Removals
from worker.storage.restoring import _Restoration
from worker.storage.store import SqlStore
from worker.storage.tables import MAPS, VIEWS


@pytest.fixture(autouse=True)
def our_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of PostgreSQL's server goes with ours, which is set here."""
    monkeypatch.setattr(clock, "shared_time", lambda connection: datetime.now(UTC))


def rows(store: SqlStore) -> tuple[int, int]:
    """Maps and views, with names or without."""
    with store._database.reading() as connection:
        counts = (connection.scalar(sa.select(sa.func.count()).select_from(table)) for table in (MAPS, VIEWS))
        maps, views = counts
    return int(maps or 0), int(views or 0)


def refuse(*_: Any) -> Any:
    raise StorageFailed("away")


def test_what_is_left_of_a_map_goes_once_the_database_is_back(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)
    with monkeypatch.context() as patch:
        patch.setattr(Removals, "_remove", refuse)
        with pytest.raises(StorageFailed):
            store.removals.delete_map("campus")
        store.tend()
    with pytest.raises(NotFound):
        store.removals.delete_map("campus")

    def is_gone() -> bool:
        store.tend()
        return rows(store) == (0, 0)

    until(is_gone)
    assert list((data / "pictures").glob("??/??/*")) == []


def test_a_map_whose_deletion_may_not_have_begun_is_left_alone(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection broke in the commit that takes the map's name; the server had not committed it."""
    enroll(store, "gate")

    monkeypatch.setattr(Database, "freeing", broken_off)
    with pytest.raises(StorageFailed):
        store.removals.delete_map("campus")
    monkeypatch.undo()
    store.tend()
    until(lambda: not store.removals._unfinished)
    assert rows(store) == (1, 1)


@pytest.mark.parametrize("gone", [True, False])
def test_recordings_go_with_the_imports_of_a_map_whose_deletion_breaks_off(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch, gone: bool
) -> None:
    """But where the map keeps its name its imports go on."""
    enroll(store, "gate")
    upload = store.uploads.receive()
    upload.write(b"a recording")
    upload.end()
    store.uploads.keep(upload, JOB, {})
    store.jobs.queue_import(JOB, "campus", RECIPE, NOW)
    parts = dict.fromkeys(
        ("maps", "comparisons", "shipped", "encoder", "describers", "catalogue", "blurring", "wake"), Mock()
    )
    service = MapService(removals=store.removals, jobs=store.jobs, uploads=store.uploads, preset="default", **parts)

    with monkeypatch.context() as patch:
        patch.setattr(*((Removals, "_remove", refuse) if gone else (Database, "freeing", broken_off)))
        with pytest.raises(StorageFailed):
            service.delete("campus")
    assert (not any((data / "imports").iterdir())) == gone


def killed(store: SqlStore) -> None:
    """What a process remembers goes with it."""
    store.removals._unfinished.clear()


def is_gone_after(store: SqlStore, minutes: float) -> bool:
    with time_machine.travel(datetime.now(UTC) + timedelta(minutes=minutes)):
        store.tend()
        if store.removals._finishing is not None:
            store.removals._finishing.join()
        return rows(store) == (0, 0)


def test_a_map_whose_deletion_was_killed_goes_with_another_service(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    enroll(store, "gate")
    with monkeypatch.context() as patch:
        patch.setattr(Removals, "_remove", refuse)
        with pytest.raises(StorageFailed):
            store.removals.delete_map("campus")
    killed(store)

    assert not is_gone_after(store, 9), "whoever deletes may be at work"
    assert is_gone_after(store, 11)
    assert list((data / "pictures").glob("??/??/*")) == []


def test_what_was_restored_half_goes_with_another_service(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(elsewhere)
    with monkeypatch.context() as patch:
        patch.setattr(store._images, "add", refuse)
        patch.setattr(store.restoring, "_undo", lambda restoration: None)
        with pytest.raises(StorageFailed):
            store.restoring.restore(made(elsewhere), None, NOW)
    assert rows(store) == (1, 5)

    assert not is_gone_after(store, 9)
    assert is_gone_after(store, 11)


def test_a_restoration_that_was_taken_for_killed_says_so(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a process that was stopped for longer than others wait."""
    filled(elsewhere)
    add = store._images.add

    def slow(images: dict[str, bytes]) -> None:
        add(images)
        assert is_gone_after(store, 11)

    monkeypatch.setattr(store._images, "add", slow)
    with pytest.raises(StorageFailed, match="removed"):
        store.restoring.restore(made(elsewhere), None, NOW)
    assert rows(store) == (0, 0)


def test_a_restoration_that_others_have_begun_to_remove_gets_no_name(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would go on, and take the map away from callers who were told that it is there."""
    filled(elsewhere)
    finish, remove = _Restoration.finish, Removals._remove
    begun, named = threading.Event(), threading.Event()

    def slow(self: Removals, map_id: int, seqs: Sequence[int], answers: StoredAnswers) -> Any:
        begun.set()
        named.wait(60)
        return remove(self, map_id, seqs, answers)

    def late(restoration: _Restoration, name: str, now: datetime) -> RestoredMap:
        monkeypatch.setattr(Removals, "_remove", slow)
        with time_machine.travel(datetime.now(UTC) + timedelta(minutes=11)):
            store.tend()
            assert begun.wait(60)
        try:
            return finish(restoration, name, now)
        finally:
            named.set()

    monkeypatch.setattr(_Restoration, "finish", late)
    with pytest.raises(StorageFailed, match="removed"):
        store.restoring.restore(made(elsewhere), None, NOW)
    assert store.removals._finishing is not None
    store.removals._finishing.join()
    assert rows(store) == (0, 0)


def test_a_long_deletion_is_left_to_who_began_it_and_the_receipt_names_all_of_it(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("gate", "pond", "hall", "stairs"):
        enroll(store, name)
    remove = Removals._remove
    with time_machine.travel(datetime.now(UTC)) as travelling:

        def slow(self: Removals, map_id: int, seqs: Sequence[int], answers: StoredAnswers) -> Any:
            gone = remove(self, map_id, seqs, answers)
            if threading.current_thread() is threading.main_thread():
                travelling.shift(timedelta(minutes=6))
                store.tend()
                if store.removals._finishing is not None:
                    store.removals._finishing.join()
            return gone

        monkeypatch.setattr(Removals, "_remove", slow)
        monkeypatch.setattr(removals, "PORTION", 1)
        receipt = store.removals.delete_map("campus")
    assert (receipt.views, receipt.images) == (4, 4)
    assert rows(store) == (0, 0)


def test_images_whose_removal_broke_off_go_once_the_database_is_back(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection breaks after the commit of a deletion, and while an enrolment is taken back."""

    def files() -> list[Path]:
        return list((data / "pictures").glob("??/??/*"))

    gate, _ = enroll(store, "gate").view, enroll(store, "pond")
    with monkeypatch.context() as patch:
        patch.setattr(store._images, "_owned", refuse)
        with pytest.raises(StorageFailed):
            store.removals.delete_view(gate.id)
        patch.setattr("worker.storage.enrolment.keep_pairs", refuse)
        with pytest.raises(StorageFailed):
            enroll(store, "hall")
        store.tend()
        assert store.removals._finishing is not None
        store.removals._finishing.join()
    with pytest.raises(NotFound):
        store.removals.delete_view(gate.id)
    assert len(files()) == 3

    def is_tidy() -> bool:
        store.tend()
        return len(files()) == 1

    until(is_tidy)
    assert store._images.left == frozenset()


def test_a_receipt_counts_its_images_though_the_service_tends_to_what_is_left_meanwhile(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [f"place {number}" for number in range(8)]
    for place in places:
        enroll(store, place)
    discard = store._images._discard  # type: ignore[attr-defined]

    def slow(digests: list[str]) -> Any:
        if threading.current_thread() is threading.main_thread():
            store.tend()
            if store.removals._finishing is not None:
                store.removals._finishing.join(0.5)  # it waits for the lock on this call's images at last
        return discard(digests)

    monkeypatch.setattr(store._images, "_discard", slow)
    receipt = store.removals.delete_views("campus", Filters())
    assert (receipt.views, receipt.images) == (len(places), len(places))


def test_images_that_a_map_keeps_no_longer_go_when_that_is_said_again(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    enroll(store, "gate")
    describe_all(store)
    with monkeypatch.context() as patch:
        patch.setattr("worker.storage.maps.forgetting.remove_all", refuse)
        with pytest.raises(StorageFailed):
            store.maps.change("campus", MapChanges(keep_images=False))
    assert len(list((data / "pictures").glob("??/??/*"))) == 1
    store.maps.change("campus", MapChanges(keep_images=False))
    assert list((data / "pictures").glob("??/??/*")) == []


def test_a_restored_map_whose_name_may_be_stored_or_not_is_whole_or_gone(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection breaks after the commit that gives the name, and again while what was restored is removed."""
    filled(elsewhere)
    snapshot = made(elsewhere)
    finish = _Restoration.finish

    def named_and_broken(restoration: _Restoration, name: str, now: datetime) -> RestoredMap:
        finish(restoration, name, now)
        raise StorageFailed("away")

    monkeypatch.setattr(_Restoration, "finish", named_and_broken)
    with monkeypatch.context() as patch:
        patch.setattr(Removals, "_remove", refuse)
        with pytest.raises(StorageFailed):
            store.restoring.restore(snapshot, None, NOW)
    assert store.maps.all() == []
    assert rows(store) == (1, 5)

    until(lambda: is_gone_after(store, 0))


def test_a_restored_map_is_nobodys_to_remove(store: SqlStore, elsewhere: SqlStore) -> None:
    filled(elsewhere)
    store.restoring.restore(made(elsewhere), None, NOW)
    assert not is_gone_after(store, 60)
    assert rows(store) == (1, 5)


def broken_off(database: Database, work: Any) -> Any:
    """Do the work in a transaction that is rolled back, and tell that nobody knows."""
    with suppress(_Undone), database.writing(frees=True) as connection:
        work(connection)
        raise _Undone
    raise StorageFailed("away")


class _Undone(Exception):
    """Ends a transaction, so that nothing of it is kept."""
