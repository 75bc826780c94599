"""Threads that answer, also where the system lets the process start no more of them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

MORE_PROCESSES = "raise the limit of processes (--pids-limit of a container, podPidsLimit, TasksMax=, ulimit -u)"
NO_MORE_THREADS = f"the system lets this process start no further thread: {MORE_PROCESSES}"


class Threads(ThreadPoolExecutor):
    """A pool that has a thread from the beginning, and does with those it has where it may start no more.

    `ThreadPoolExecutor` raises then, although a thread that it has does the work later: who asked is told of a failure,
    and a photo is enrolled all the same.

    Parameters
    ----------
    most : int or None
        Of threads; None: as many as asyncio's own pool has.
    name : str
        Of the threads.
    initializer : function, optional
        What each thread does first.

    Raises
    ------
    RuntimeError
        There is not even one.
    """

    def __init__(self, most: int | None, name: str, initializer: Callable[[], object] | None = None) -> None:
        super().__init__(most, name, initializer)
        self.submit(lambda: None)

    def _adjust_thread_count(self) -> None:
        try:
            super()._adjust_thread_count()
        except RuntimeError as error:
            if not (self._threads and is_shortage(error)):
                raise


def is_shortage(error: BaseException) -> bool:
    """Whether Python says by this error that no thread can be started."""
    return isinstance(error, RuntimeError) and str(error) == "can't start new thread"
