"""Which images are sent: so many a second, one at a time, every so many metres."""

import math
from collections import deque
from typing import Generic, TypeVar

from revisit_ros.frames import Vector

Item = TypeVar("Item")


class Pace:
    """At most so many a second, and one out of turn for each trigger.

    Parameters
    ----------
    rate : float
        Times a second; 0: only when triggered.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1 / rate if rate > 0 else math.inf
        self._last: float | None = None
        self.triggered = False

    def due(self, now: float) -> bool:
        """Whether it is time; `now` in seconds of a clock that never goes back."""
        if self.triggered:
            return True
        if self._last is None:
            return self._period < math.inf
        return now - self._last >= self._period * (1 - 1e-9)

    def take(self, now: float) -> None:
        """Begin one."""
        self._last, self.triggered = now, False


class Waiting(Generic[Item]):
    """What waits for its turn: when there are more than `most`, the oldest is dropped and counted."""

    def __init__(self, most: int) -> None:
        self._items: deque[Item] = deque()
        self._most = most
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> None:
        """Behind all others."""
        self._items.append(item)
        if len(self._items) > self._most:
            self._items.popleft()
            self.dropped += 1

    def put_back(self, item: Item) -> None:
        """Before all others; dropped where these are `most` already, since it is the oldest."""
        if len(self._items) >= self._most:
            self.dropped += 1
        else:
            self._items.appendleft(item)

    def take(self) -> Item | None:
        """The oldest; None without one."""
        return self._items.popleft() if self._items else None

    def peek(self) -> Item | None:
        """The oldest, which stays; None without one."""
        return self._items[0] if self._items else None


class Stride:
    """Every so many metres, or every so many degrees.

    Parameters
    ----------
    metres : float
        Distance from the last pose that was taken.
    degrees : float
        Turn since then; 0: turns alone do not count.
    """

    def __init__(self, metres: float, degrees: float) -> None:
        self._metres, self._degrees = metres, degrees
        self._last: tuple[Vector, float | None] | None = None

    def far_enough(self, position: Vector, heading: float | None) -> bool:
        """Whether a pose lies that far from the last one; the first one does."""
        if self._last is None:
            return True
        where, faced = self._last
        if math.dist(position, where) >= self._metres:
            return True
        if not self._degrees or heading is None or faced is None:
            return False
        return abs(math.remainder(heading - faced, 360)) >= self._degrees

    def take(self, position: Vector, heading: float | None) -> None:
        """Count from this pose on."""
        self._last = position, heading


class HandOver:
    """Whether a pose is to be handed over: the first one, the first one after each trigger, or every one.

    Parameters
    ----------
    every : bool
    """

    def __init__(self, every: bool) -> None:
        self._every = every
        self.wanted = True

    def triggered(self) -> None:
        """The next one again."""
        self.wanted = True

    def handed(self) -> None:
        """One was taken."""
        self.wanted = self._every
