"""Errors of the disk and of the database, as errors of revisit: full, not to be written, or away for now."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from schemas.errors import Damaged, DiskFull, RevisitError, SetupError, StorageFailed
from worker.storage import error_codes
from worker.storage.retrying import RolledBack

_READ_ONLY, _IO_ERROR, _CANNOT_OPEN, _NO_PERMISSION = 8, 10, 14, 3
_SQLITE = {
    _READ_ONLY: "it is read-only",
    _IO_ERROR: "the disk reports an error",
    _CANNOT_OPEN: "its file cannot be opened",
    _NO_PERMISSION: "its permissions forbid it",
}
_FILES = frozenset({errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ENODEV, errno.ENXIO, errno.EMFILE})

FULL = "the disk of the {} is full, or a quota of it; free some space or delete views"
SERVER_FULL = (
    "the disk of the database server is full; whoever runs it should make room there: deletions may fail until then, "
    "queries work, the service goes on by itself"
)
DAMAGED = (
    "the file of the database is damaged ({}): whoever runs the service should stop it, then run "
    "`./revisit doctor --repair` or restore a backup"
)
AWAY = "the database server cannot be asked: {}; try again in a moment, the service goes on by itself"
REFUSES = "the database server refuses: {}; whoever runs it should see to that, the service goes on by itself"
BUSY = "the database was being written by others, or locked, for too long; try again in a moment"
ENCODING = (
    "the encoding of the database{} lacks characters; whoever runs the service should move it to one made with "
    "`CREATE DATABASE ... ENCODING 'UTF8' TEMPLATE template0`"
)
FAILED = "the {} cannot be written or read: {}; see to the disk, the service goes on by itself"


def problem_of(error: BaseException, what: str, *, sent: bool = True) -> RevisitError | None:
    """DiskFull, StorageFailed or Damaged when the disk, the file, the server or other writers are at fault, else None.

    Parameters
    ----------
    error : BaseException
    what : str
        ``database`` or ``images``, for the text.
    sent : bool
        Whether the server may have been told to commit; else it is RolledBack where it is StorageFailed by the server.
    """
    if error_codes.is_full(error):
        server = getattr(getattr(error, "orig", None), "sqlstate", None) is not None
        return DiskFull(SERVER_FULL if server else FULL.format(what))
    if isinstance(error, sa.exc.DBAPIError):
        if error_codes.is_damaged(error):
            return Damaged(DAMAGED.format(error.orig))
        if error_codes.lacks_characters(error):
            return SetupError(ENCODING.format(""))
        if error_codes.is_busy(error):
            return StorageFailed(BUSY)
        trouble = error_codes.server_trouble(error)
        if trouble is not None:
            kept_nothing = error_codes.kept_nothing(error, sent=sent)
            return (RolledBack if kept_nothing else StorageFailed)(AWAY.format(trouble))
        refusal = error_codes.server_refusal(error)
        if refusal is not None:
            return StorageFailed(REFUSES.format(refusal))
        code = (getattr(error.orig, "sqlite_errorcode", 0) or 0) & 0xFF
        return StorageFailed(FAILED.format(what, _SQLITE[code])) if code in _SQLITE else None
    if isinstance(error, OSError) and error.errno in _FILES:
        return StorageFailed(FAILED.format(what, os.strerror(error.errno)))
    return None


def lacking_right(error: BaseException) -> str | None:
    """The message of PostgreSQL about a right that the user lacks, where an error of `problem_of` comes from that.

    None for other errors. It is for whoever runs the service.
    """
    diagnostics = getattr(getattr(error.__cause__, "orig", None), "diag", None)
    return str(diagnostics.message_primary) if diagnostics is not None and diagnostics.sqlstate == "42501" else None


@contextmanager
def translated(what: str, *, sent: bool = True) -> Iterator[None]:
    """Raise errors of the disk and of the database inside the block as DiskFull, StorageFailed or Damaged.

    `sent`: as in `problem_of`.
    """
    try:
        yield
    except (OSError, sa.exc.DBAPIError) as error:
        problem = problem_of(error, what, sent=sent)
        if problem is None:
            raise
        raise problem from error
