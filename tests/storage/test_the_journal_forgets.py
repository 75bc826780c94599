"""What is told to be gone stands in no file of SQLite's, its journal among them."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from schemas.records import Filters, ViewAttributes
from tests.storage.carried import views
from tests.storage.databases import put_tables, sqlite_url
from tests.storage.material import NOW, RECIPE, describe_all, description, enroll
from worker.storage.database import Database
from worker.storage.store import SqlStore, open_store

GARDEN = "the garden of anna"
PHOTO = b"\xff\xd8 a photo of a passer-by \xff\xd9"


@pytest.fixture
def store(data: Path) -> Iterator[SqlStore]:
    """A store on SQLite with a map of one place, and a query of it that matched nothing."""
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:
        store.maps.put("campus", RECIPE, NOW)
        store.maps.change("campus", MapChanges(keep_queries=5))
        enroll(store, "gate", attributes=ViewAttributes(GARDEN))
        describe_all(store)
        store.kept_queries.keep("campus", QueryToKeep("query", RECIPE.description, description(1), PHOTO, NOW))
        yield store


def stands(data: Path, what: bytes) -> list[str]:
    """Names of the files that have some bytes."""
    return [path.name for path in data.iterdir() if path.is_file() and what in path.read_bytes()]


def test_what_was_stored_stands_in_the_journal(store: SqlStore, data: Path) -> None:
    assert stands(data, GARDEN.encode())
    assert stands(data, PHOTO)


DELETIONS: dict[str, Callable[[SqlStore, str], object]] = {
    "a view": lambda store, view: store.removals.delete_view(view),
    "views": lambda store, view: store.removals.delete_views("campus", Filters(place=GARDEN)),
    "a map": lambda store, view: store.removals.delete_map("campus"),
}


@pytest.mark.parametrize("what", DELETIONS)
def test_a_place_that_was_deleted_is_in_no_file_once_the_call_returns(store: SqlStore, data: Path, what: str) -> None:
    [view] = views(store)
    DELETIONS[what](store, view.id)
    assert stands(data, GARDEN.encode()) == []


def test_neither_is_a_query_that_was_dismissed(store: SqlStore, data: Path) -> None:
    assert store.kept_queries.delete("campus", ["query"]) == 1
    assert stands(data, PHOTO) == []


@pytest.mark.parametrize("changes", [MapChanges(keep_queries=0), MapChanges(keep_queries=0, refuse_poor=True)])
def test_nor_queries_that_are_kept_no_longer(store: SqlStore, data: Path, changes: MapChanges) -> None:
    store.maps.change("campus", changes)
    assert stands(data, PHOTO) == []


def test_a_query_that_made_room_for_others_goes_a_moment_later(store: SqlStore, data: Path) -> None:
    for number in range(5):
        store.kept_queries.keep("campus", QueryToKeep(str(number), RECIPE.description, description(1), b"another", NOW))
    store.tend()
    assert stands(data, PHOTO) == []


def test_what_a_view_had_before_it_was_changed_goes_a_moment_later(store: SqlStore, data: Path) -> None:
    [view] = views(store)
    store.views.change(view.id, lambda has: replace(has, place=None))
    store.tend()
    assert stands(data, GARDEN.encode()) == []


def test_while_somebody_reads_it_stays_and_goes_afterwards(store: SqlStore, data: Path) -> None:
    """A snapshot that is being made reads the map as it was."""
    [view] = views(store)
    other = Database(sqlite_url(data))
    with closing(other), other.reading() as connection:
        connection.exec_driver_sql("SELECT count(*) FROM views").all()
        store.removals.delete_view(view.id)
        store.tend()
        assert stands(data, GARDEN.encode())
    store.tend()
    assert stands(data, GARDEN.encode()) == []
