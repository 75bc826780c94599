"""Whose turn it is at the encoder: queries first, but never for long while enrolments wait."""

import threading
from bisect import insort
from dataclasses import dataclass
from typing import Generic, TypeVar

QUERY, ENROLMENT, CLOSE = 0, 1, 2
"""Urgencies, the most urgent first."""

IN_A_ROW = 8
"""Queries that may go before an enrolment that waits. So one query in nine waits for one image more, and enrolments get
a ninth of the encoder while others query without a pause."""


@dataclass(order=True)
class Waiting:
    """A request.

    Parameters
    ----------
    urgency : int
        `QUERY`, `ENROLMENT` or `CLOSE`.
    number : int
        Requests of the same urgency are served by it, the least first, but for queries where callers give up: `Turns`.
    """

    urgency: int
    number: int

    @property
    def given_up(self) -> bool:
        """Whether nobody waits for it any more: it takes nobody's turn."""
        return False


R = TypeVar("R", bound=Waiting)


class Turns(Generic[R]):
    """A queue that any threads may use: queries before enrolments, `CLOSE` after everything.

    After `IN_A_ROW` queries that an enrolment waited for, one enrolment has its turn.

    The oldest query has the turn while callers wait as long as the queue takes. After one that was given up before its
    turn the newest has the next: the next oldest may be about to be given up too. Served in their order alone, callers
    with less patience than the queue is long would give up one by one just as they are served (adaptive LIFO: Maurer,
    Fail at Scale, ACM Queue 13(8), 2015).
    """

    def __init__(self) -> None:
        self._requests: dict[int, list[R]] = {QUERY: [], ENROLMENT: [], CLOSE: []}
        self._count = threading.Semaphore(0)
        self._lock = threading.Lock()
        self._in_a_row = 0
        self._waited_in_vain = False

    def put(self, request: R) -> None:
        """Add a request, or give one back: it keeps its place."""
        with self._lock:
            insort(self._requests[request.urgency], request)
        self._count.release()

    def wake(self) -> None:
        """Have `get` return, though nothing may be there to do."""
        self._count.release()

    def get(self, timeout_s: float | None = None) -> R | None:
        """The next request; None when there was none for so many seconds, or after `wake`."""
        if not self._count.acquire(timeout=timeout_s):
            return None
        with self._lock:
            return self._take(self._turn()) if any(self._requests.values()) else None

    def get_alike(self, request: R) -> R | None:
        """The next request if there is one and it is as urgent: it can join the batch."""
        if not self._count.acquire(blocking=False):
            return None
        with self._lock:
            if self._turn() == request.urgency:
                return self._take(request.urgency)
        self._count.release()
        return None

    def _turn(self) -> int:
        """Whose turn it is, while something waits."""
        queries, enrolments = self._requests[QUERY], self._requests[ENROLMENT]
        if enrolments and (not queries or self._in_a_row >= IN_A_ROW):
            return ENROLMENT
        return QUERY if queries else CLOSE

    def _take(self, urgency: int) -> R:
        newest = urgency == QUERY and self._waited_in_vain
        request = self._requests[urgency].pop(-1 if newest else 0)
        if not request.given_up:
            passed = urgency == QUERY and bool(self._requests[ENROLMENT])
            self._in_a_row = self._in_a_row + 1 if passed else 0
        if urgency == QUERY:
            self._waited_in_vain = request.given_up
        return request
