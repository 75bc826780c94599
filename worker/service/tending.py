"""What a worker does when no job waits: sweep, build indexes, compare views."""

from collections.abc import Callable
from typing import Protocol

from worker.service.giving_way import Rest


class Sweeping(Protocol):
    """What crashes left in a store that several processes share."""

    def step(self) -> bool:
        """Remove some of it; returns whether there was anything to do."""
        ...


class Indexing(Protocol):
    """Indexes that are built in the background."""

    def step(self) -> bool:
        """Do one piece of work; returns whether there was anything to do."""
        ...


class Comparing(Protocol):
    """Comparisons of a map's views."""

    def step(self, *, busy: bool = False, rest: Rest) -> bool:
        """Compare a portion of views; returns whether there was anything to do."""
        ...


def idle_work(
    sweeping: Sweeping | None, indexing: Indexing | None, comparer: Comparing | None
) -> Callable[[bool, Rest], bool]:
    """One piece of what is given; its arguments say whether images wait to be described, and how to rest between."""

    def step(busy: bool, rest: Rest) -> bool:
        if sweeping is not None and sweeping.step():
            return True
        if indexing is not None and indexing.step():
            return True
        return comparer is not None and comparer.step(busy=busy, rest=rest)

    return step
