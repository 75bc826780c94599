"""The stores that every promise is tried on."""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import cache
from pathlib import Path

import pytest

from tests.storage.databases import DATABASES, data_folder, postgres_schema, sqlite_url
from worker.storage.store import SqlStore, open_store

Open = Callable[[], SqlStore]


@pytest.fixture
def data() -> Iterator[Path]:
    """An empty data folder."""
    with data_folder() as folder:
        yield folder


@pytest.fixture(params=DATABASES)
def database_url(request: pytest.FixtureRequest, data: Path) -> Iterator[str]:
    """URL of an empty database."""
    if request.param == "sqlite":
        yield sqlite_url(data)
        return
    with postgres_schema() as url:
        yield url


@pytest.fixture
def reopen(database_url: str, data: Path) -> Iterator[Open]:
    """Opens the store, again each time it is called, as another process would."""
    opened: list[SqlStore] = []

    def open_again() -> SqlStore:
        opened.append(open_store(database_url, data))
        return opened[-1]

    yield open_again
    for store in opened:
        store.close()


@cache
def migrated_file() -> bytes:
    """A SQLite file with all tables: going through the migrations takes longer than most tests."""
    with data_folder() as folder:
        open_store(sqlite_url(folder), folder).close()
        return (folder / "revisit.db").read_bytes()


@pytest.fixture
def store(database_url: str, data: Path, reopen: Open) -> SqlStore:
    """An empty store."""
    if database_url == sqlite_url(data):
        (data / "revisit.db").write_bytes(migrated_file())
    return reopen()


@pytest.fixture
def elsewhere() -> Iterator[SqlStore]:
    """An empty store on another machine, on SQLite."""
    with data_folder() as folder, closing(open_store(sqlite_url(folder), folder)) as store:
        yield store
