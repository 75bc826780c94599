"""Tells whoever works on jobs, in this process and in others, that there is something to do."""

from collections.abc import Callable
from typing import Protocol


class Notices(Protocol):
    """Notices to other processes."""

    def work(self) -> None:
        """Tell that a job was queued; returns at once."""
        ...

    def settled(self, view_id: str) -> None:
        """Tell that a view was described or failed; returns at once."""
        ...

    def start(self, *, on_work: Callable[[], None] | None, on_settled: Callable[[str], None] | None) -> None:
        """Begin to send and to receive."""
        ...

    def stop(self) -> None:
        """End."""
        ...


class Works(Protocol):
    """The loop of this process."""

    def wake(self) -> None:
        """Look for images to describe."""
        ...

    def wake_all(self) -> None:
        """Look for images to describe and for jobs of maps."""
        ...

    def on_finish(self, notify: Callable[[str], None]) -> None:
        """Call a function with the id of each view that was described or failed."""
        ...


class Bell:
    """Wakes the loop of this process, once there is one, and those of others.

    Parameters
    ----------
    notices : Notices or None
        None where no other machine works on the same database.
    settled : function
        Wakes who waits in this process for a view.
    """

    def __init__(self, notices: Notices | None, settled: Callable[[str], None]) -> None:
        self._notices, self._settled = notices, settled
        self._loop: Works | None = None

    def hang(self, loop: Works) -> None:
        """Wake this loop from now on, and tell what it has settled."""
        self._loop = loop
        loop.on_finish(self._settled)
        if self._notices is not None:
            loop.on_finish(self._notices.settled)

    def ring(self) -> None:
        """There is an image to describe."""
        if self._loop is not None:
            self._loop.wake()
        if self._notices is not None:
            self._notices.work()

    def ring_all(self) -> None:
        """There is a job, of whatever kind."""
        if self._loop is not None:
            self._loop.wake_all()
        if self._notices is not None:
            self._notices.work()

    def start(self, *, waits: bool) -> None:
        """Begin to hear others; `waits`: whether callers of this process wait for views."""
        if self._notices is not None:
            on_work = None if self._loop is None else self._loop.wake_all
            self._notices.start(on_work=on_work, on_settled=self._settled if waits else None)

    def stop(self) -> None:
        """Hear nobody any longer."""
        if self._notices is not None:
            self._notices.stop()
