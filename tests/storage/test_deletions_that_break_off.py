"""The deletion of a map that breaks off is finished without a new start: no call finds the map any more."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.errors import NotFound, StorageFailed
from tests.storage.material import describe_all, enroll
from tests.waiting import until
from worker.storage.database import Database
from worker.storage.removals import Removals
from worker.storage.store import SqlStore
from worker.storage.tables import MAPS, VIEWS


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


def broken_off(database: Database, work: Any) -> Any:
    """Do the work in a transaction that is rolled back, and tell that nobody knows."""
    with suppress(_Undone), database.writing(frees=True) as connection:
        work(connection)
        raise _Undone
    raise StorageFailed("away")


class _Undone(Exception):
    """Ends a transaction, so that nothing of it is kept."""
