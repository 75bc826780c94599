"""Work on bytes in a thread of its own: hashing and writing let the other threads run meanwhile."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor


class OneThread:
    """Does work in the order in which it is given, in one thread of its own.

    Parameters
    ----------
    name : str
        Of the thread.
    most_bytes : int
        Most bytes that wait together; work on more waits alone.
    """

    def __init__(self, name: str, most_bytes: int) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        self._most, self._waiting = most_bytes, 0
        self._given: deque[tuple[int, Future[object]]] = deque()

    def do(self, size: int, work: Callable[[], object]) -> None:
        """Queue work on `size` bytes; waits until the work before it leaves room. Raises what earlier work raised."""
        while self._given and (self._waiting + size > self._most or self._given[0][1].done()):
            self._await_first()
        self._given.append((size, self._thread.submit(work)))
        self._waiting += size

    def finish(self) -> None:
        """Wait until all is done; raises what any of it raised."""
        while self._given:
            self._await_first()

    def close(self) -> None:
        """Wait for the work that has begun, and drop the rest."""
        self._thread.shutdown(cancel_futures=True)

    def _await_first(self) -> None:
        size, work = self._given.popleft()
        self._waiting -= size
        work.result()
