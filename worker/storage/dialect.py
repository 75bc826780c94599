"""All that differs between SQLite and PostgreSQL, besides the column types."""

import errno
from typing import Any

import sqlalchemy as sa
from sqlalchemy.pool import QueuePool

from schemas.errors import SetupError

BUSY_S = 60
"""How long a writer of SQLite waits for its turn, in seconds."""

WRITERS = 0x7265766973697400
"""Advisory lock of PostgreSQL that writers take one after the other ("revisit" in ASCII)."""

SQLITE_FULL = 13


def make_engine(url: str) -> sa.Engine:
    """An engine that is careful with what it was given.

    Parameters
    ----------
    url : str
        SQLAlchemy URL, ``sqlite:///...`` with a file or ``postgresql+psycopg://...``.

    Raises
    ------
    SetupError
        Another database, or one in memory, which would be lost.
    """
    try:
        parsed = sa.make_url(url)
    except sa.exc.ArgumentError:
        raise SetupError(f"REVISIT_DATABASE: {url!r} is not a database URL") from None
    if parsed.get_backend_name() == "postgresql":
        return _postgresql(parsed)
    if parsed.get_backend_name() == "sqlite" and parsed.database not in (None, "", ":memory:"):
        return _sqlite(parsed)
    raise SetupError(f"REVISIT_DATABASE: use a file of SQLite or PostgreSQL, not {parsed.render_as_string()}")


def _postgresql(url: sa.URL) -> sa.Engine:
    try:
        return sa.create_engine(url.set(drivername="postgresql+psycopg"), max_overflow=-1, pool_pre_ping=True)
    except ModuleNotFoundError:
        raise SetupError("PostgreSQL needs an extra package: pip install 'revisit[postgres]'") from None


def _sqlite(url: sa.URL) -> sa.Engine:
    # A connection serves one thread at a time: each block takes one from the pool and gives it back at its end.
    engine = sa.create_engine(url, poolclass=QueuePool, max_overflow=-1, connect_args={"timeout": BUSY_S})

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: Any, _: object) -> None:
        connection.isolation_level = None  # or the driver would begin transactions when it thinks best
        for pragma in (
            "page_size=8192",  # of a new file: a description takes 8 pages to read instead of 16
            "journal_mode=WAL",
            "synchronous=FULL",  # in WAL, NORMAL forgets acknowledged commits when the power goes
            "foreign_keys=ON",
            "secure_delete=ON",  # what was deleted cannot be read from the file
            "journal_size_limit=67108864",  # bytes of the WAL file kept after a large change
            "cache_size=-16384",  # KiB
        ):
            connection.execute(f"PRAGMA {pragma}").close()

    @sa.event.listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        # A transaction that has read cannot wait to become a writer: writers say so when they begin, and queue.
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def for_reading(connection: sa.Connection) -> sa.Connection:
    """Make all that a block reads belong to one moment."""
    if connection.dialect.name == "postgresql":
        return connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
    return connection


def for_writing(connection: sa.Connection) -> sa.Connection:
    """Make a block a writer from its beginning."""
    if connection.dialect.name == "postgresql":  # whatever its default: each statement sees what `take_turn` waited for
        return connection.execution_options(isolation_level="READ COMMITTED")
    return connection.execution_options(writes=True)


def take_turn(connection: sa.Connection) -> None:
    """Wait until no other transaction writes, as SQLite does anyway.

    Without that, PostgreSQL would commit revisions out of order, and an index that asks for what came after its own
    would miss some.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(sa.text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": WRITERS})


def is_full(error: BaseException) -> bool:
    """Whether the database or the disk under it has no room left."""
    if isinstance(error, sa.exc.DBAPIError):
        code = getattr(error.orig, "sqlite_errorcode", 0) or 0
        return code & 0xFF == SQLITE_FULL or getattr(error.orig, "sqlstate", None) == "53100"
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def is_file(engine: sa.Engine) -> bool:
    """Whether the database lives in the data folder rather than in a server."""
    return engine.dialect.name == "sqlite"
