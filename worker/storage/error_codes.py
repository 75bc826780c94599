"""What errors of SQLite and PostgreSQL mean, by their codes: of SQLite its result codes, of PostgreSQL SQLSTATEs."""

import errno
import re
import sqlite3

import sqlalchemy as sa

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
    """Whether an error means that others held a lock for too long (`dialect.BUSY_S`)."""
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
        reason = _FATAL.search(str(error.orig))  # names of users and databases are not for callers
        return "there is no connection to it" + (f" ({_NAMED.sub('', reason[1])})" if reason else "")
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
