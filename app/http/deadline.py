"""A deadline for a whole HTTP exchange, however steadily the other side says a little more."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from socket import SHUT_RDWR, socket

CONNECTED = (".connect_tcp.complete", ".start_tls.complete")
"""Ends of the names of httpx's trace events whose result is the stream of a connection."""


class Deadline:
    """Breaks the connection of the call that is under way when its time is over.

    httpx bounds each read and each write: an answer of which a byte comes every second never ends. It is told of
    connections by httpx's extension ``trace``. One call at a time.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket: socket | None = None
        self._call, self._timers = 0, list[threading.Timer]()
        self.is_over = False
        """Whether the last call was broken off."""

    def trace(self, event: str, about: Mapping[str, object]) -> None:
        """What ``extensions={"trace": ...}`` of a call takes."""
        if event.endswith(CONNECTED):
            stream = about["return_value"]
            self._socket = stream.get_extra_info("socket")  # type: ignore[attr-defined]
            if self.is_over:  # while it was connecting
                self._break()

    @contextmanager
    def within(self, seconds: float) -> Iterator[None]:
        """Break off what the block calls after so many seconds."""
        with self._lock:
            self._call, self.is_over = self._call + 1, False
            self._arm(seconds)
        try:
            yield
        finally:
            with self._lock:
                for timer in self._timers:
                    timer.cancel()
                self._timers.clear()

    def hurry(self, seconds: float) -> None:
        """Break off the call that is under way after so many seconds, if that is sooner; from any thread."""
        with self._lock:
            if self._timers:
                self._arm(seconds)

    def _arm(self, seconds: float) -> None:
        timer = threading.Timer(max(seconds, 0), self._end, (self._call,))
        timer.daemon = True
        timer.start()
        self._timers.append(timer)

    def _end(self, call: int) -> None:
        with self._lock:
            if call == self._call and self._timers:
                self.is_over = True
                self._break()

    def _break(self) -> None:
        if self._socket is not None:
            with suppress(OSError):
                # That of the plain socket: with TLS, another thread that reads would find its TLS taken away.
                socket.shutdown(self._socket, SHUT_RDWR)
