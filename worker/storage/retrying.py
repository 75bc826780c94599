"""Retries of what PostgreSQL rolled back, because others changed the same rows or another server took over.

A transaction whose connection broke during the commit is never retried: nobody knows whether it was committed.
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
"""Seconds before each retry."""

JITTER = 0.5
"""Share by which a pause is drawn longer or shorter, so that transactions which met once do not meet again."""


class RolledBack(StorageFailed):
    """The server kept nothing of a transaction, and a retry may succeed."""


class Commits(threading.local):
    """Number of transactions that the present thread has committed to a database."""

    count = 0


def run_with_retries(commits: Commits, run: Callable[[], T]) -> T:
    """Call `run` until it is not rolled back, at most once more after each of `PAUSES_S`; returns what it returns.

    It is not retried once it has committed something.

    Parameters
    ----------
    commits : Commits
        Of the database that `run` writes to.
    run : function
        May be called several times, so it must have no effect but on what it stores.

    Raises
    ------
    StorageFailed
        The last attempt was rolled back too, or an attempt was after it had committed something.
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


def retried(method: Callable[..., T]) -> Callable[..., T]:
    """A method of a part of the store, with retries; see `run_with_retries`."""

    @functools.wraps(method)
    def run(self: Any, *args: Any, **kwargs: Any) -> T:
        return run_with_retries(self._database.commits, lambda: method(self, *args, **kwargs))

    return run
