"""Differences between SQLite and PostgreSQL, except column types."""

import errno
import os
import re
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

AS_BYTES = "as_bytes"
"""Execution option of statements that read long bodies: PostgreSQL would send each byte as two digits otherwise."""

SQLITE_FULL = 13
SQLITE_DAMAGED = (11, 26)  # malformed, not a database
SQLITE_UNREADABLE = (266, 522, 8202, 8458)  # I/O errors in reading: failed, short, checksum, file system

_IN_A_MOMENT = {
    "57P01": "it is being stopped",
    "57P02": "it crashed",
    "57P03": "it is starting",
    "53300": "it has no connection left",
    "25006": "it takes no writes: it is a standby, or its default_transaction_read_only is on",
    "40001": "others changed the same rows",
    "40P01": "others waited for the same rows",
    "25P03": "this process was silent for too long while it wrote",
}

_REFUSES = {
    "57014": "it cut a statement short (its statement_timeout, or somebody by hand)",
    "25P04": "its transaction_timeout is shorter than a transaction",
    "42501": "its user may not do this any more",
    "53200": "it is out of memory",
    "58030": "its disk reports an error",
}
"""What to tell whoever runs the server, by code. For other codes of `_OPERATORS` the server's message is told."""

_OPERATORS = ("28", "3D", "3F", "42501", "42P01", "53", "57", "58", "25P04")
"""Beginnings of codes that no statement of ours causes: rights, names, resources, operators, the system."""

_OVER = frozenset({"40001", "40P01"})
"""Codes that say of a transaction, whatever it was doing, that nothing of it is kept."""

_FATAL = re.compile(r"\bFATAL:\s+(.*)")
_NAMED = re.compile(r"( for| of)?( user| role| database)? \"[^\"]*\"")


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
            "synchronous=FULL",  # in WAL, NORMAL loses acknowledged commits in a power failure
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


def make_reader(url: str, *, damaged: bool = False) -> sa.Engine:
    """An engine that cannot write, for examinations: a SQLite file is opened read only and left as it is.

    Parameters
    ----------
    url : str
    damaged : bool
        Read as much as possible: past a definition that is damaged, and of a file that was cut off.
    """
    parsed = sa.make_url(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database is None:
        return make_engine(url)
    path = Path(parsed.database).absolute()
    # Beside a file SQLite makes others even to read it. Where it may not, the file alone can be read, without its log.
    still = "" if os.access(path.parent, os.W_OK) or _has_log(path) else "&immutable=1"
    address = f"file:{quote(str(path))}?mode=ro{still}"

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
    """Begin a transaction on a connection of `make_reader`, whose reads all see one snapshot.

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


def _wait(connection: sa.Connection, seconds: float) -> None:
    with raw_cursor(connection) as cursor:
        cursor.execute(f"PRAGMA busy_timeout={round(1000 * seconds)}")


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


def is_full(error: BaseException) -> bool:
    """Whether an error means that the disk or the database is full."""
    if isinstance(error, sa.exc.DBAPIError):
        code = getattr(error.orig, "sqlite_errorcode", 0) or 0
        return code & 0xFF == SQLITE_FULL or getattr(error.orig, "sqlstate", None) == "53100"
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def is_damaged(error: sa.exc.DBAPIError) -> bool:
    """Whether an error means that the file of the database cannot be read as one."""
    code = getattr(error.orig, "sqlite_errorcode", 0) or 0
    return (
        code & 0xFF in SQLITE_DAMAGED
        or code in SQLITE_UNREADABLE
        or getattr(error.orig, "sqlstate", None) in ("XX001", "XX002")
    )


def is_busy(error: BaseException) -> bool:
    """Whether an error means that others held a lock for `BUSY_S`."""
    orig = getattr(error, "orig", None)
    code = getattr(orig, "sqlite_errorcode", 0) or 0
    return code & 0xFF == sqlite3.SQLITE_BUSY or getattr(orig, "sqlstate", None) == "55P03"


def is_unopened(error: BaseException) -> bool:
    """Whether an error means that SQLite may not open a file, or may not make one beside it."""
    code = getattr(getattr(error, "orig", error), "sqlite_errorcode", 0) or 0
    return code & 0xFF in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)


def server_trouble(error: sa.exc.DBAPIError) -> str | None:
    """Why PostgreSQL cannot do now what it may do in a moment, in words; None for other errors.

    Codes are of appendix A of its manual. An error of a connection that never came about has none.
    """
    state = getattr(error.orig, "sqlstate", "")
    if state in _IN_A_MOMENT:
        return _IN_A_MOMENT[state]
    if state is None or error.connection_invalidated:
        if not isinstance(error, sa.exc.OperationalError):
            return None
        said = _FATAL.search(str(error.orig))  # names of users and databases are not for callers
        return "there is no connection to it" + (f" ({_NAMED.sub('', said[1])})" if said else "")
    return "there is no connection to it" if state[:2] == "08" else None


def server_refusal(error: sa.exc.DBAPIError) -> str | None:
    """What whoever runs PostgreSQL has to see to before it does this again, in words; None for other errors."""
    state = getattr(error.orig, "sqlstate", None) or ""
    if not state.startswith(_OPERATORS):
        return None
    return _REFUSES.get(state) or f"it says {error.orig.diag.message_primary!r}"  # type: ignore[union-attr]


def lacks_characters(error: sa.exc.DBAPIError) -> bool:
    """Whether the encoding of the database has no code for a character."""
    return getattr(error.orig, "sqlstate", None) == "22P05"


def encoding_of(connection: sa.Connection) -> str | None:
    """The encoding of a PostgreSQL database that cannot hold, or filter by, every character; None for others."""
    if connection.dialect.name != "postgresql":
        return None
    encoding = str(connection.scalar(sa.text("SHOW server_encoding")))
    return None if encoding == "UTF8" else encoding  # SQL_ASCII takes bytes as they come, and knows no characters


def is_read_only(error: sa.exc.DBAPIError) -> bool:
    """Whether a connection cannot write, since it is to a standby or began while writes were forbidden.

    Another connection may be able to.
    """
    return getattr(error.orig, "sqlstate", None) == "25006"


def kept_nothing(error: sa.exc.DBAPIError, *, sent: bool) -> bool:
    """Whether a server in trouble kept nothing of the transaction, so that it may be run again at once.

    Parameters
    ----------
    error : DBAPIError
        For which `server_trouble` has words.
    sent : bool
        Whether the server may have been told to commit. If it was, only an answer of the server counts: a broken
        connection does not tell whether the commit was done.
    """
    return not sent or getattr(error.orig, "sqlstate", None) in _OVER


def is_file(engine: sa.Engine) -> bool:
    """Whether the database is a file rather than a server."""
    return engine.dialect.name == "sqlite"
