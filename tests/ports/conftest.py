"""The stores that every promise is tried on."""

import os
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from worker.stores.store import SqlStore, open_store

Open = Callable[[], SqlStore]


SERVER = os.environ.get("REVISIT_TEST_POSTGRES")


@pytest.fixture(params=["sqlite", "postgresql"] if SERVER else ["sqlite"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """URL of an empty database; PostgreSQL too when REVISIT_TEST_POSTGRES has the URL of one to try it on."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'revisit.db'}"
        return
    assert SERVER is not None
    url = sa.make_url(SERVER).set(drivername="postgresql+psycopg")
    schema = f"test_{uuid.uuid4().hex}"
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        connection.execute(sa.schema.CreateSchema(schema))
    yield url.update_query_dict({"options": f"-csearch_path={schema}"}).render_as_string(hide_password=False)
    with engine.begin() as connection:
        connection.execute(sa.schema.DropSchema(schema, cascade=True))
    engine.dispose()


@pytest.fixture
def reopen(database_url: str, tmp_path: Path) -> Iterator[Open]:
    """Opens the store, again each time it is called, as another process would."""
    opened: list[SqlStore] = []

    def open_again() -> SqlStore:
        opened.append(open_store(database_url, tmp_path))
        return opened[-1]

    yield open_again
    for store in opened:
        store.close()


@pytest.fixture
def store(reopen: Open) -> SqlStore:
    """An empty store."""
    return reopen()
