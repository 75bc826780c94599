"""Locks on a data folder: one `serve` and any number of workers, or one `migrate` alone.

The locks are `flock`s: the system releases them when their process ends, however it ends, so none is ever stale.
"""

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from schemas.errors import SetupError

SERVE = "serve.lock"
USE = "use.lock"
MIGRATE = "migrate.lock"


class FolderLock:
    """A lock on a file that is held until `release`.

    Parameters
    ----------
    path : Path
        Created when there is none, and never removed: two processes could then lock two files of the same name.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)

    def acquire(self, *, shared: bool = False, wait: bool = False) -> bool:
        """Take the lock, or change its mode; False when another process holds it and `wait` is False."""
        try:
            fcntl.flock(self._file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            return False
        return True

    def release(self) -> None:
        """Release the lock; a second time does nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def sign(self, now: datetime) -> None:
        """Write the holder (process, host, time) to the file, for `holder`."""
        text = json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": now.isoformat(" ", "seconds")})
        with suppress(OSError):  # on a full disk the lock holds all the same
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, text.encode(), 0)

    def holder(self) -> str:
        """The last holder that signed, as text for messages."""
        try:
            signed = json.loads(os.pread(self._file, 4096, 0))
            return f"process {signed['pid']} on {signed['host']} since {signed['since']}"
        except (ValueError, KeyError, TypeError):  # not signed yet
            return "another process"


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Wait for a lock and hold it during a block."""
    lock = FolderLock(path)
    try:
        lock.acquire(wait=True)
        yield
    finally:
        lock.release()


def lock_for_serving(data: Path, now: datetime) -> FolderLock:
    """Take the lock of the one service of a data folder.

    Raises
    ------
    SetupError
        Another process serves the folder, and the text names it; or the folder cannot be written.
    """
    try:
        lock = FolderLock(data / SERVE)
    except OSError as error:
        raise SetupError(f"the data folder {data} cannot be used: {error.strerror}; see REVISIT_DATA") from error
    if not lock.acquire():
        holder = lock.holder()
        lock.release()
        raise SetupError(
            f"{data} is served already by {holder}; stop that service, or give this one another folder "
            "with REVISIT_DATA (more processes may help to describe images: ./revisit worker)"
        )
    lock.sign(now)
    return lock
