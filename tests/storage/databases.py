"""Empty databases and folders to try a store in."""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import sqlalchemy as sa

POSTGRES = os.environ.get("REVISIT_TEST_POSTGRES")
"""URL of a PostgreSQL database to try the adapter on, besides SQLite."""


@contextmanager
def data_folder() -> Iterator[Path]:
    """A data folder; in memory where the system offers that, because each promise of a store waits for a disk."""
    memory = Path("/dev/shm")
    with TemporaryDirectory(prefix="revisit-", dir=memory if os.access(memory, os.W_OK) else None) as folder:
        yield Path(folder)


def sqlite_url(folder: Path) -> str:
    """URL of the database of a data folder."""
    return f"sqlite:///{folder / 'revisit.db'}"


@contextmanager
def postgres_schema(server: str) -> Iterator[str]:
    """URL of a schema of its own in a PostgreSQL database."""
    url = sa.make_url(server).set(drivername="postgresql+psycopg")
    schema = f"test_{uuid.uuid4().hex}"
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        connection.execute(sa.schema.CreateSchema(schema))
    try:
        yield url.update_query_dict({"options": f"-csearch_path={schema}"}).render_as_string(hide_password=False)
    finally:
        with engine.begin() as connection:
            connection.execute(sa.schema.DropSchema(schema, cascade=True))
        engine.dispose()
