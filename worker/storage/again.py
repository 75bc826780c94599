"""Runs again what PostgreSQL rolled back: because others changed the same rows, or while another server took over.

What was to be committed when the connection broke is never run again: nobody knows whether it was.
"""

import functools
import logging
import random
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from schemas.errors import StorageFailed

T = TypeVar("T")

log = logging.getLogger("revisit")

PAUSES_S = (0.05, 0.1, 0.2, 0.4, 0.8)
"""Seconds before each further run, give or take half: those that met once should not meet again."""

JITTER = 0.5


class RolledBack(StorageFailed):
    """The server kept nothing of a transaction, for a reason that may be over in a moment."""


class Commits(threading.local):
    """How many transactions the thread has committed."""

    count = 0


def again(commits: Commits, run: Callable[[], T]) -> T:
    """What `run` returns, which is called again where it was rolled back before it committed anything.

    Parameters
    ----------
    commits : Commits
        Of the database that it writes to.
    run : function
        Does the same each time but for what it stores.

    Raises
    ------
    StorageFailed
        It was rolled back each time, or after it had committed something.
    """
    before = commits.count
    pauses = iter(PAUSES_S)
    while True:
        try:
            return run()
        except RolledBack as error:
            pause_s = None if commits.count != before else next(pauses, None)
            if pause_s is None:
                raise StorageFailed(error.detail) from error
            log.info("a transaction was rolled back and is run again: %s", error.detail, extra={"event": "run_again"})
            time.sleep(pause_s * random.uniform(1 - JITTER, 1 + JITTER))


def run_again(method: Callable[..., T]) -> Callable[..., T]:
    """A method of a part of the store that is run again as `again` does."""

    @functools.wraps(method)
    def tried(self: Any, *args: Any, **kwargs: Any) -> T:
        return again(self._database.commits, lambda: method(self, *args, **kwargs))

    return tried
