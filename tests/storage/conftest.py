"""The stores that every promise is tried on."""

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.storage.databases import DATABASES, data_folder, postgres_schema, postgres_tables, put_tables, sqlite_url
from tests.storage.object_store import ADDRESS, BUCKET, PREFIX, ObjectStore, aws, server
from worker.storage.store import SqlStore, open_store

Open = Callable[[], SqlStore]


@pytest.fixture
def data() -> Iterator[Path]:
    """An empty data folder."""
    with data_folder() as folder:
        yield folder


@pytest.fixture(params=DATABASES)
def database_url(request: pytest.FixtureRequest, data: Path) -> Iterator[str]:
    """URL of an empty database, which has its tables already where an empty store is wanted."""
    wanted = "store" in request.fixturenames
    if request.param == "sqlite":
        if wanted:
            put_tables(data)
        yield sqlite_url(data)
        return
    with postgres_tables() if wanted else postgres_schema() as url:
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


@pytest.fixture
def store(reopen: Open) -> SqlStore:
    """An empty store."""
    return reopen()


@pytest.fixture
def elsewhere() -> Iterator[SqlStore]:
    """An empty store on another machine, on SQLite."""
    with data_folder() as folder:
        put_tables(folder)
        with closing(open_store(sqlite_url(folder), folder)) as store:
            yield store


class Place:
    """A store whose images lie in one of the places, and a way to meddle with them."""

    def __init__(self, data: Path, url: str, objects: ObjectStore | None) -> None:
        self.data, self.url, self.objects = data, url, objects
        self.address = None if objects is None else ADDRESS
        self.store = self.open()

    def open(self) -> SqlStore:
        return open_store(self.url, self.data, 0, self.address)

    def digests(self) -> list[str]:
        """Of all images that are there."""
        if self.objects is not None:
            return [name.rpartition("/")[2] for name in self.objects.names() if not name.startswith("snapshots/")]
        return sorted(path.name for path in (self.data / "pictures").glob("*/*/*"))

    def put(self, digest: str, content: bytes | None) -> None:
        """Write an image behind the store's back, or remove it."""
        name = f"{digest[:2]}/{digest[2:4]}/{digest}"
        if self.objects is None:
            path = self.data / "pictures" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True) if content is None else path.write_bytes(content)
        elif content is None:
            self.objects.client.delete_object(Bucket=BUCKET, Key=PREFIX + name)
        else:
            self.objects.client.put_object(Bucket=BUCKET, Key=PREFIX + name, Body=content)


@pytest.fixture(params=["folder", "objects", "objects, postgresql"])
def place(request: pytest.FixtureRequest, data: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    objects = None
    if request.param != "folder":
        objects = server()
        objects.empty()
        for name, value in aws(objects.url).items():
            monkeypatch.setenv(name, value)
    if request.param.endswith("postgresql"):
        with postgres_tables() as url:
            made = Place(data, url, objects)
            yield made
            made.store.close()
        return
    put_tables(data)
    made = Place(data, sqlite_url(data), objects)
    yield made
    made.store.close()
