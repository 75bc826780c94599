"""Work on bytes that goes on in a thread beside: hashing and writing wait for memory and disk alone."""

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
        Bytes that wait at most; a larger one waits alone.
    """

    def __init__(self, name: str, most_bytes: int) -> None:
        self._thread = ThreadPoolExecutor(1, name)
        self._most, self._waiting = most_bytes, 0
        self._given: deque[tuple[int, Future[object]]] = deque()

    def do(self, size: int, work: Callable[[], object]) -> None:
        """Have work done on `size` bytes, once there is room for them; raises what earlier work raised."""
        while self._given and (self._waiting + size > self._most or self._given[0][1].done()):
            self._await_first()
        self._given.append((size, self._thread.submit(work)))
        self._waiting += size

    def finish(self) -> None:
        """Wait until all is done; raises what any of it raised."""
        while self._given:
            self._await_first()

    def close(self) -> None:
        """Wait for the work that has begun, and give up the rest."""
        self._thread.shutdown(cancel_futures=True)

    def _await_first(self) -> None:
        size, work = self._given.popleft()
        self._waiting -= size
        work.result()
