"""One decoder's process as the service holds it."""

import errno
import mmap
import os
import signal
import socket
import subprocess
from concurrent.futures import Executor
from contextlib import suppress
from typing import Any

from schemas.errors import Unavailable
from schemas.threads import MORE_PROCESSES
from worker.images.apart.launching import launched
from worker.images.apart.protocol import READY, Request, mapped, receive_reply, shared_memory
from worker.images.codec import Limits

START_S = 60
"""Seconds within which a process must be ready; it takes a third of one."""

STARTS = 3
"""Attempts to start a process."""

THUMBNAIL_ROOM = 64 * 1024 * 1024
_KEPT = 64 * 1024 * 1024  # more memory than this is given back after an image that needed it


class Died(Exception):
    """The process ended amid a request; the text says how."""


class Hung(Exception):
    """The process did not answer in time, and was killed."""


class DecoderProcess:
    """Starts a process, speaks with it, and kills it. Used by one thread at a time.

    Parameters
    ----------
    limits : Limits
    deadline_s : float
        Seconds for one image.
    launching : Executor
        Launches the process, which has the priority of the thread that does, whoever the image is for.
    """

    def __init__(self, limits: Limits, deadline_s: float, launching: Executor) -> None:
        self._limits, self._deadline_s, self._launching = limits, deadline_s, launching
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._source: mmap.mmap | None = None
        self._target: mmap.mmap | None = None
        self._ready = False
        self.starts = 0

    @property
    def pid(self) -> int | None:
        """Process id; None before it is started."""
        return None if self._process is None else self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it was started and has not ended; it may not be ready yet."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start it without waiting until it is ready; raises Unavailable when the system gives no process."""
        if self.runs:
            return
        self.kill()
        ours, theirs = socket.socketpair()
        numbers: list[int] = []
        try:
            numbers.append(shared_memory(self._limits.max_bytes))
            numbers.append(shared_memory(max(3 * self._limits.max_pixels, THUMBNAIL_ROOM)))
            self._source, self._target = map(mapped, numbers)
            arguments = (theirs.fileno(), *numbers, self._limits.max_bytes, self._limits.max_pixels, self._deadline_s)
            passed = theirs.fileno(), *numbers
            self._process = self._launching.submit(
                launched, "worker.images.apart.child", arguments, stdout=subprocess.DEVNULL, passed=passed
            ).result()
        except OSError as error:
            ours.close()
            remedy = MORE_PROCESSES if error.errno == errno.EAGAIN else "try again in 5 s"
            raise Unavailable(f"no process for decoding can be started ({error}); {remedy}", 5) from error
        finally:
            theirs.close()
            for number in numbers:
                os.close(number)
        self._connection, self._ready = ours, False
        self.starts += 1

    def ask(self, kind: int, data: bytes, longest: int = 0) -> tuple[dict[str, Any], mmap.mmap]:
        """The reply about an image, and the memory that holds what was made of it, valid until the next call.

        Raises
        ------
        Died, Hung, Unavailable
        """
        self.make_ready()
        assert self._connection is not None  # for the type checker: `start` made all of them
        assert self._source is not None
        assert self._target is not None
        try:
            self._source[: len(data)] = data
            self._connection.settimeout(self._deadline_s)
            Request(kind, len(data), longest).send(self._connection)
            return receive_reply(self._connection), self._target
        except TimeoutError as error:
            self.kill()
            raise Hung from error
        except (EOFError, OSError, ValueError) as error:
            raise Died(self._end()) from error

    def tidy(self, used: int) -> None:
        """Give memory back after an image of `used` bytes, if that is much."""
        if used > _KEPT and self._target is not None and hasattr(mmap, "MADV_REMOVE"):
            with suppress(OSError):
                self._target.madvise(mmap.MADV_REMOVE)

    def kill(self) -> None:
        """End it at once, and release its memory."""
        self._end()
        for memory in (self._source, self._target):
            if memory is not None:
                memory.close()
        self._source = self._target = None

    def _end(self) -> str:
        """Make sure that it has ended; how it did."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._process is None:
            return "it was not running"
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)
        if self._process.poll() is None:
            self._process.kill()
        code = self._process.wait()
        self._process = None
        with suppress(ValueError):
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with code {code}"

    def make_ready(self) -> None:
        """Start it and wait for it, again when it ends meanwhile; raises Unavailable."""
        how = ""
        for _ in range(STARTS):
            self.start()
            if self._ready or self._becomes_ready():
                return
            how = self._end()
        raise Unavailable(f"a process for decoding did not become ready ({how}); try again in 5 s", 5)

    def _becomes_ready(self) -> bool:
        if self._connection is None:
            return False
        self._connection.settimeout(START_S)
        with suppress(OSError):
            self._ready = self._connection.recv(1) == READY
        return self._ready
