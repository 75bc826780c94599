"""Whoever waits for the answer to a query, and may go before its turn comes."""

import threading
from concurrent.futures import CancelledError, Future
from typing import Any, TypeVar

from schemas.errors import CallerGone

T = TypeVar("T")


class Caller:
    """Whoever waits for an answer. Once they have left, nothing is begun for them; what is under way is finished."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._gone = False
        self._awaited: Future[Any] | None = None

    def leave(self) -> None:
        """Note that they wait no longer, and cancel what has not begun; may be called from any thread."""
        with self._lock:
            self._gone, awaited = True, self._awaited
        if awaited is not None:
            awaited.cancel()

    def check(self) -> None:
        """Raise CallerGone once they have left."""
        if self._gone:
            raise CallerGone

    def result(self, future: "Future[T]") -> T:
        """What a future gives; raises CallerGone where they left before it was begun, and cancels it."""
        with self._lock:
            self._awaited, gone = future, self._gone
        if gone:
            future.cancel()
        try:
            return future.result()
        except CancelledError:
            raise CallerGone from None
