"""Whether what a worker makes can be stored: said once when that changes, not at every attempt."""

import logging
import threading
from collections.abc import Callable

from schemas.errors import DiskFull, RevisitError, StorageFailed

log = logging.getLogger("revisit.worker")

STORAGE_ERRORS = (DiskFull, StorageFailed)
"""Errors that go away when the disk does better: what could not be stored is kept and tried again."""

FIRST_PAUSE_S = 0.25


class StoringTrouble:
    """The latest error of storing, while it lasts.

    Parameters
    ----------
    what : str
        What cannot be stored, for the log.
    longest_pause_s : float
        Seconds between attempts, after many.
    tell : function
        Called with the error when trouble begins, and with None when it ends.
    """

    def __init__(
        self, what: str, longest_pause_s: float, tell: Callable[[RevisitError | None], None] = lambda _: None
    ) -> None:
        self._what, self._longest_pause_s, self._tell = what, longest_pause_s, tell
        self._lock = threading.Lock()
        self._error: RevisitError | None = None
        self._pause_s = FIRST_PAUSE_S

    @property
    def error(self) -> RevisitError | None:
        """The error, or None when storing works."""
        return self._error

    def begins(self, error: RevisitError) -> float:
        """Note that storing failed; returns the seconds to wait before the next attempt."""
        with self._lock:
            began, self._error = self._error is None, error
            pause_s = self._pause_s
            self._pause_s = min(2 * pause_s, self._longest_pause_s)
        if began:
            log.error("%s cannot be stored: %s; it is tried until it works", self._what, error.detail)
        self._tell(error)
        return pause_s

    def ends(self) -> None:
        """Note that storing works."""
        with self._lock:
            ended, self._error = self._error is not None, None
            self._pause_s = FIRST_PAUSE_S
        if ended:
            log.warning("%s can be stored again", self._what)
            self._tell(None)
