"""Migrates a database to the tables of this version."""

from contextlib import closing
from functools import cache
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from schemas.errors import SetupError
from worker.storage import dialect, vector_tables
from worker.storage.database import Database
from worker.storage.disk_errors import ENCODING
from worker.storage.locks import MIGRATE, USE, FolderLock, held
from worker.storage.peers import is_served

SERVED = (
    "the database must be migrated, but a service on another machine, or with another data folder, uses it; stop all "
    "services and workers first. One that was killed or cut off counts for up to a minute more"
)

SCRIPTS = Path(__file__).parent / "migrations"


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS).replace("%", "%%"))
    return config


@cache
def known() -> tuple[str, ...]:
    """All revisions that this version knows, newest first."""
    return tuple(script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


def newest() -> str:
    """The revision of the tables that this version needs, such as ``0001``."""
    return known()[0]


def current(connection: sa.Connection) -> str | None:
    """The revision of a database's tables; None without tables."""
    return MigrationContext.configure(connection).get_current_revision()


def is_current(connection: sa.Connection) -> bool:
    """Whether a database has the tables that this version needs.

    Raises
    ------
    SetupError
        The database was made by a newer version.
    """
    found = current(connection)
    if found is not None and found not in known():
        raise SetupError(
            f"the database has tables of revision {found}, which is newer than this version of revisit "
            f"({newest()}); run the newer version, or put the backup from before the upgrade in its place"
        )
    return found == newest()


def migrate(url: str, data: Path, index: str = "faiss") -> str:
    """Migrate a database while no other process uses its data folder; returns the revision of its tables.

    Where `index` is one in the database, its tables are made too.

    Raises
    ------
    SetupError
        Other processes use the folder, or the database is newer than this version.
    """
    with closing(Database(url)) as database:
        enter(database, data, may_migrate=True).release()
        if index != "faiss":
            vector_tables.prepare(database)
    return newest()


def enter(database: Database, data: Path, *, may_migrate: bool) -> FolderLock:
    """Take the shared lock of a data folder, after migrating its database when needed.

    Parameters
    ----------
    database : Database
    data : Path
    may_migrate : bool
        Whether to migrate existing tables; an empty database always gets its tables.

    Returns
    -------
    FolderLock
        Keeps `migrate` out until it is released.

    Raises
    ------
    SetupError
        As `migrate`; or the tables are older and `may_migrate` is False.
    """
    share = FolderLock(data / USE)
    try:
        with held(data / MIGRATE):  # a second process finds the tables migrated
            with database.reading() as connection:
                ready = is_current(connection)
                empty = current(connection) is None
            if not ready:
                _upgrade(database, data, share, allowed=may_migrate or empty)
            share.acquire(shared=True, wait=True)
    except BaseException:
        share.release()
        raise
    return share


def _upgrade(database: Database, data: Path, share: FolderLock, *, allowed: bool) -> None:
    if not allowed:
        raise SetupError(
            "the tables of the database are older than this version of revisit; stop all services and workers, "
            "then run `./revisit migrate`"
        )
    if not share.acquire():
        raise SetupError(
            f"the database of {data} must be migrated, but other processes use it; stop all services and workers first"
        )
    create(database)


def create(database: Database) -> None:
    """Bring the tables of a database that nobody else uses to this version.

    Raises
    ------
    SetupError
        It is empty, and could not hold every character; or it is older, and served by a process elsewhere.
    """
    config = _config()
    with database.writing() as connection:  # all or nothing: both databases roll back changes of tables
        found = current(connection)
        if found is None and (encoding := dialect.encoding_of(connection)) is not None:
            raise SetupError(ENCODING.format(f", {encoding},"))
        # Whoever made an empty one's tables a moment ago may serve it by now.
        if found not in (None, newest()) and is_served(connection):
            raise SetupError(SERVED)
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def migrates_by_itself(database: Database) -> bool:
    """Whether opening a store may migrate: a SQLite file, yes; a PostgreSQL server, no."""
    return dialect.is_file(database.engine)
