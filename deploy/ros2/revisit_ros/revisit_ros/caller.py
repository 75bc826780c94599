"""Calls of the service, one at a time, in a thread beside the executor."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Generic, TypeVar

Job = TypeVar("Job")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Outcome(Generic[Job, Answer]):
    """How a call ended: with an answer, or an error."""

    job: Job
    answer: Answer | None
    error: Exception | None
    seconds: float


class Caller(Generic[Job, Answer]):
    """Runs `call` for one job after the other, and wakes the executor after each.

    Parameters
    ----------
    call : callable
        Answers a job, or raises. It has time limits of its own.
    wake : callable
        Called in this thread after each; what it wakes takes `outcomes`.
    clock : callable
        Seconds.
    """

    def __init__(self, call: Callable[[Job], Answer], wake: Callable[[], None], clock: Callable[[], float]) -> None:
        self._call, self._wake, self._clock = call, wake, clock
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._done: deque[Outcome[Job, Answer]] = deque()
        # A daemon: a call that hangs does not keep the process.
        self._thread = threading.Thread(target=self._run, name="revisit", daemon=True)
        self._thread.start()

    def start(self, job: Job) -> None:
        """Run a job when those before it are done."""
        self._jobs.put(job)

    def outcomes(self) -> list[Outcome[Job, Answer]]:
        """All that ended since the last time."""
        taken = []
        while self._done:
            taken.append(self._done.popleft())
        return taken

    def close(self, timeout: float) -> None:
        """End the thread; wait for a call that runs, but no longer than `timeout` seconds."""
        self._jobs.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            began = self._clock()
            answer, error = None, None
            try:
                answer = self._call(job)
            except Exception as raised:  # whatever it is, the node goes on and tells it
                error = raised
            self._done.append(Outcome(job, answer, error, self._clock() - began))
            try:
                self._wake()
            except Exception as raised:  # the node is being destroyed
                logging.getLogger(__name__).debug("nobody to wake: %s", raised)
