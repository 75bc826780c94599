"""The memory that bodies of requests may take together."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from app.http.notes import note
from schemas.errors import Busy

PATIENCE_S = 5.0
"""Seconds for which a body may arrive before it makes room for others. A phone sends its photo in one or two."""

SMALL_BYTES = 1_000_000
"""Of a body for which the last quarter of the room is kept: large photos that are enrolled do not keep queries out."""

RETRY_S = 2

MEMORY = "memory"
"""Name of this limit, in the log and the metrics."""

LET_GO = "let_go_of_body"
"""Key of a request's state: a function to be called once nothing holds its body any more, before the answer."""


class Body:
    """One body, from before its first byte until nothing holds it any more.

    Attributes
    ----------
    byte_count : int
        That are held of it in memory.
    made_room : bool
        Whether the wait for more of it was ended in favour of others.
    """

    def __init__(self, began: float) -> None:
        self.began = began
        self.byte_count = 0
        self.made_room = False
        self._waiting: asyncio.Timeout | None = None

    @property
    def waits(self) -> bool:
        """Whether its next bytes are being waited for."""
        return self._waiting is not None

    @asynccontextmanager
    async def wait(self, seconds: float) -> AsyncIterator[None]:
        """Wait for its next bytes; raises TimeoutError after so many seconds, or where it makes room."""
        try:
            async with asyncio.timeout(seconds) as self._waiting:
                yield
        finally:
            self._waiting = None

    def make_room(self) -> None:
        """End that wait."""
        if self._waiting is not None:
            self._waiting.reschedule(0)  # at once
            self._waiting, self.made_room = None, True


class BodyRoom:
    """Counts the bytes of all bodies that are held, and refuses what would be more; bodies of more than `SMALL_BYTES`
    have three quarters of the room.

    Where there is no room, bodies that have been arriving for more than `PATIENCE_S` are given up for it, the oldest
    first. Otherwise a few connections that send all but the last byte and stop would keep everybody else out.

    Parameters
    ----------
    most_bytes : int
    largest : int
        Bytes of the largest body that is taken, which has room however little that is.
    clock : function
        Seconds of a clock that never goes back.
    """

    def __init__(self, most_bytes: int, largest: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._most = max(most_bytes, largest)
        self._most_large = max(3 * self._most // 4, largest)
        self._clock = clock
        self._bodies: set[Body] = set()
        self._held = 0

    def open(self) -> Body:
        """A body that is about to arrive."""
        body = Body(self._clock())
        self._bodies.add(body)
        return body

    def add(self, body: Body, byte_count: int) -> None:
        """Count what has arrived of a body; raises Busy where there is no room for it."""
        most = self._most if body.byte_count + byte_count <= SMALL_BYTES else self._most_large
        if self._held + byte_count > most:
            self._make_room(most - byte_count)
        body.byte_count += byte_count
        self._held += byte_count

    def close(self, body: Body) -> None:
        """Nothing holds a body any more, or its request was answered; may be called again."""
        self._bodies.discard(body)
        self._let_go(body)

    def _make_room(self, most: int) -> None:
        """Hold no more than that; raises Busy."""
        now = self._clock()
        slow = [one for one in self._bodies if one.waits and one.byte_count and now - one.began > PATIENCE_S]
        for one in sorted(slow, key=lambda body: body.began):
            one.make_room()
            self._let_go(one)
            if self._held <= most:
                return
        note(limit=MEMORY)
        raise Busy(f"bodies of other requests take all the memory there is for them; try again in {RETRY_S} s", RETRY_S)

    def _let_go(self, body: Body) -> None:
        self._held -= body.byte_count
        body.byte_count = 0
