"""Differences between SQLite and PostgreSQL, except column types and the codes of errors (error_codes.py)."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy.pool import NullPool, QueuePool

from schemas.errors import SetupError
from schemas.settings import without_password

BUSY_S = 60
"""Seconds that a writer waits for its turn."""

READS_WAIT_S = 10
"""Seconds that a reader of PostgreSQL waits for a lock. Only `LOCK TABLE` and what changes tables keep readers out."""

SILENT_S = 10
"""Seconds after which PostgreSQL ends a writing transaction whose process says nothing: it was stopped, or cut off."""

SERVER_GONE = {
    "connect_timeout": 5,  # seconds, as are the next three
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 20_000,  # milliseconds
}
"""When a PostgreSQL server that vanished without a word counts as away; parameters of a URL go before them."""

WRITERS = 0x7265766973697400
"""Key of PostgreSQL's advisory lock that writers take in turn ("revisit" in ASCII)."""

DURABLE = "synchronous=FULL"
"""In WAL, NORMAL loses acknowledged commits in a power failure."""

AS_BYTES = "as_bytes"
"""Execution option of statements that read long bodies: PostgreSQL would send each byte as two digits otherwise."""


def make_engine(url: str) -> sa.Engine:
    """The engine of a database, set up for durable writes and consistent reads.

    Parameters
    ----------
    url : str
        ``sqlite:///...`` with a file, or ``postgresql://...``; ``postgres://...`` is the same.

    Raises
    ------
    SetupError
        Neither PostgreSQL nor a file of SQLite.
    """
    try:
        parsed = sa.make_url(url)
    except (sa.exc.ArgumentError, ValueError):  # ValueError: of a port that is no number
        raise SetupError(f"REVISIT_DATABASE: {without_password(url)!r} is not a database URL") from None
    if parsed.get_backend_name() in ("postgresql", "postgres"):  # libpq takes either
        return _postgresql(parsed)
    if parsed.get_backend_name() == "sqlite" and parsed.database not in (None, "", ":memory:"):
        return _sqlite(parsed)
    raise SetupError(f"REVISIT_DATABASE: use a file of SQLite or PostgreSQL, not {parsed.render_as_string()}")


def _postgresql(url: sa.URL) -> sa.Engine:
    patience = {
        name: value for name, value in {**SERVER_GONE, "client_encoding": "utf8"}.items() if name not in url.query
    }
    url = url.set(drivername="postgresql+psycopg")
    engine = sa.create_engine(url, hide_parameters=True, max_overflow=-1, pool_pre_ping=True, connect_args=patience)

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: Any, _: object) -> None:
        connection.autocommit = True
        connection.execute(_session())
        connection.autocommit = False

    @sa.event.listens_for(engine, "checkout")
    def may_be_read_only(connection: Any, *_: object) -> None:
        # SQLAlchemy would say READ WRITE once a transaction was READ ONLY. A standby has no code of its own for that,
        # and it would override what is set for the server.
        connection.read_only = None

    @sa.event.listens_for(engine, "before_cursor_execute")
    def choose_format(
        _: sa.Connection, cursor: Any, statement: str, parameters: Any, context: Any, executemany: bool
    ) -> None:
        if context is not None and context.execution_options.get(AS_BYTES):
            cursor.format = 1  # psycopg.pq.Format.BINARY

    return engine


def _session() -> str:
    """The statement that a connection begins with; it overrides what is set for the server, the database or the user.

    With it, what was acknowledged is durable, times and numbers are read as they were written, and no reader waits for
    ever.
    """
    return (
        f"SELECT set_config('lock_timeout', '{round(1000 * READS_WAIT_S)}', false), "
        "set_config('datestyle', 'ISO', false), "
        "set_config('timezone', 'UTC', false), "  # elsewhere the first or last hours are no datetime
        "set_config('extra_float_digits', '3', false), "  # or numbers come rounded, and fit no checksum
        "set_config('synchronous_commit', replace(current_setting('synchronous_commit'), 'off', 'on'), false)"
    )


def _sqlite(url: sa.URL) -> sa.Engine:
    # Each transaction takes a connection from the pool, so that no two threads share one.
    patience = {"timeout": BUSY_S}
    engine = sa.create_engine(url, hide_parameters=True, poolclass=QueuePool, max_overflow=-1, connect_args=patience)

    @sa.event.listens_for(engine, "connect")
    def prepare(connection: Any, _: object) -> None:
        connection.isolation_level = None  # or the driver would begin transactions by itself
        connection.text_factory = _text
        for pragma in (
            "page_size=8192",  # of a new file: a description takes 8 pages to read instead of 16
            "journal_mode=WAL",
            DURABLE,
            "foreign_keys=ON",
            "secure_delete=ON",  # deleted content is overwritten in the file
            "journal_size_limit=67108864",  # bytes of the WAL file kept after a large change
            "cache_size=-16384",  # KiB
            "temp_store=MEMORY",  # sorting for a query must not need the disk
        ):
            connection.execute(f"PRAGMA {pragma}").close()

    @sa.event.listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        # A reading transaction cannot wait to become a writer, so writers lock at the beginning, and queue.
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


@contextmanager
def reader(url: str, *, damaged: bool = False) -> Iterator[sa.Engine]:
    """An engine that cannot write, for examinations: a SQLite file is opened read only and left as it is.

    Parameters
    ----------
    url : str
    damaged : bool
        Read as much as possible: past a definition that is damaged, and of a file that was cut off.
    """
    engine = _make_reader(url, damaged)
    try:
        yield engine
    finally:
        engine.dispose()


def _make_reader(url: str, damaged: bool) -> sa.Engine:
    parsed = sa.make_url(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database is None:
        return make_engine(url)
    path = Path(parsed.database).absolute()
    # Beside a file SQLite makes others even to read it. Where it may not, the file alone can be read, without its log.
    still = "" if os.access(path.parent, os.W_OK) or _has_log(path) else "&immutable=1"
    address = f"file:{quote(os.fsencode(path))}?mode=ro{still}"

    def connect() -> sqlite3.Connection:
        connection = sqlite3.connect(address, uri=True, timeout=BUSY_S, check_same_thread=False)
        connection.text_factory = _text
        if damaged:
            connection.execute("PRAGMA writable_schema=ON").close()
        return connection

    return sa.create_engine("sqlite://", hide_parameters=True, creator=connect, poolclass=NullPool)


def _has_log(path: Path) -> bool:
    log = path.with_name(path.name + "-wal")
    return log.exists() and log.stat().st_size > 0


def _text(stored: bytes) -> str:
    """Stored text; damaged UTF-8 becomes lone surrogates instead of an error that would bring down the statement."""
    return stored.decode("utf-8", "surrogateescape")


def for_reading(connection: sa.Connection) -> sa.Connection:
    """A connection whose transaction reads one snapshot."""
    if connection.dialect.name == "postgresql":
        return connection.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
    return connection


def begin_reading(connection: sa.Connection) -> None:
    """Begin a transaction on a connection of `reader`, whose reads all see one snapshot.

    Python's driver for SQLite does not begin one by itself.
    """
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql("BEGIN")


def for_writing(connection: sa.Connection) -> sa.Connection:
    """A connection whose transaction writes from its beginning."""
    if connection.dialect.name == "postgresql":  # after its turn has come each statement sees earlier commits
        return connection.execution_options(isolation_level="READ COMMITTED")
    return connection.execution_options(writes=True)


@contextmanager
def patient(connection: sa.Connection, seconds: float | None) -> Iterator[None]:
    """Have SQLite wait so long for others in the block, instead of `BUSY_S`; None, and PostgreSQL: as without it."""
    if seconds is None or connection.dialect.name != "sqlite":
        yield
        return
    _wait(connection, seconds)
    try:
        yield
    finally:
        _wait(connection, BUSY_S)


@contextmanager
def synced(connection: sa.Connection, durable: bool) -> Iterator[None]:
    """Have SQLite commit without waiting for the disk in the block, unless `durable`; PostgreSQL waits in either case.

    The log stays in order: the next durable commit makes those before it durable too.
    """
    if durable or connection.dialect.name != "sqlite":
        yield
        return
    _set(connection, "synchronous=NORMAL")
    try:
        yield
    finally:
        try:
            _set(connection, DURABLE)
        except sa.exc.DBAPIError:
            connection.invalidate()  # or whoever gets it next would acknowledge what is not durable
            raise


def _wait(connection: sa.Connection, seconds: float) -> None:
    _set(connection, f"busy_timeout={round(1000 * seconds)}")


def _set(connection: sa.Connection, pragma: str) -> None:
    with raw_cursor(connection) as cursor:
        cursor.execute(f"PRAGMA {pragma}")


def begin_writing(connection: sa.Connection, *, in_turn: bool, patience_s: float | None = None) -> None:
    """Limit how long a transaction that writes may wait for others and keep others waiting, as its first statement.

    Without the second limit a process that is stopped in a transaction, or cut off, would hold up all others until the
    server notices that it is gone, which may be hours.

    Parameters
    ----------
    connection : Connection
        In the transaction.
    in_turn : bool
        Wait until no other transaction writes, as SQLite does by itself. Otherwise PostgreSQL could commit revisions
        out of order, and an index that reads the changes since its own would miss some.
    patience_s : float or None
        For which it may wait; None: `BUSY_S`. SQLite has begun already: see `patient`.
    """
    if connection.dialect.name != "postgresql":
        return
    turn = f"pg_advisory_xact_lock({WRITERS})" if in_turn else ""
    connection.execute(bounded(SILENT_S, turn, patience_s))


def bounded(silent_s: float, lock: str = "", patience_s: float | None = None) -> sa.Executable:
    """A statement of PostgreSQL that bounds the waits of the transaction it is in, then takes a lock if one is given.

    Parameters
    ----------
    silent_s : float
        Seconds between statements after which the server ends the transaction.
    lock : str
        A call of ``pg_advisory_xact_lock``. Its wait, as that for any lock later, ends after `patience_s`.
    patience_s : float or None
        None: `BUSY_S`.
    """
    busy_s = BUSY_S if patience_s is None else patience_s
    limits = {"lock_timeout": busy_s, "idle_in_transaction_session_timeout": silent_s}
    calls = [f"set_config('{name}', '{round(1000 * seconds)}', true)" for name, seconds in limits.items()]
    return sa.text(f"SELECT {', '.join(calls + [lock] * bool(lock))}")


def one_of(column: sa.Column[int], numbers: str, database: str) -> sa.ColumnElement[bool]:
    """SQL condition that a column is one of the integers in the parameter `numbers`; `database` is a dialect's name.

    PostgreSQL takes them as one array: a thousand parameters are slower to send and to plan than their rows to read.
    """
    if database == "postgresql":
        return column == sa.any_(sa.bindparam(numbers, type_=sa.ARRAY(sa.BigInteger)))
    return column.in_(sa.bindparam(numbers, expanding=True))


@contextmanager
def raw_cursor(connection: sa.Connection) -> Iterator[Any]:
    """The driver's own cursor in a transaction, for what SQLAlchemy has no words for; raises SQLAlchemy's errors."""
    cursor = connection.connection.cursor()
    base = connection.dialect.loaded_dbapi.Error
    try:
        yield cursor
    except base as error:
        raise sa.exc.DBAPIError.instance(None, None, error, base) from error
    finally:
        cursor.close()


def encoding_of(connection: sa.Connection) -> str | None:
    """The encoding of a PostgreSQL database that cannot hold, or filter by, every character; None for others."""
    if connection.dialect.name != "postgresql":
        return None
    encoding = str(connection.scalar(sa.text("SHOW server_encoding")))
    return None if encoding == "UTF8" else encoding  # SQL_ASCII takes bytes as they come, and knows no characters


def is_file(engine: sa.Engine) -> bool:
    """Whether the database is a file rather than a server."""
    return engine.dialect.name == "sqlite"
