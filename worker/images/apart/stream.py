"""Images that a process of its own takes out of a file, one after another."""

import hashlib
import json
import signal
import struct
import subprocess
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from schemas.latest import Latest
from worker.images.apart.launching import launched

HEADER = struct.Struct("<IQ")
"""What goes before each image: its number, and its length in bytes."""

KEPT = 16
"""Images kept after they were read: some are read twice, and a few at once."""


class Repeated(Exception):
    """An image that is the same as an earlier one of its file."""


class Ended(Exception):
    """The process ended instead of answering; the text says how."""


class ImageStream:
    """A process that lists the images of a file, and another that sends them in order.

    Parameters
    ----------
    child : str
        A module that is run with ``list`` or ``send`` and the arguments. It writes one JSON object, or images after a
        `HEADER` each, numbered upwards; those it cannot give are left out.
    arguments : object
        As text.
    """

    def __init__(self, child: str, *arguments: object) -> None:
        self._child, self._arguments = child, arguments
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: str | None = None  # why no more images come
        self._kept: Latest[int, bytes] = Latest(KEPT)
        self._first: dict[bytes, int] = {}
        self._last = -1  # the number that came last
        self._wanted: frozenset[int] | None = None

    def listed(self, kept: Path | None = None) -> dict[str, Any]:
        """What the process says of the file, for which all of it may have to be read; raises Ended.

        Parameters
        ----------
        kept : Path or None
            A file where that is kept for the next call with the same arguments, the path apart, which may change. One
            that is missing, damaged or cannot be written is no error.
        """
        wanted = " ".join([self._child, *map(str, self._arguments[1:])]).encode()
        answer = b""
        with suppress(OSError, ValueError):
            seal, found = kept.read_bytes().split(b"\n", 1) if kept is not None else (b"", b"")
            if seal == _seal(wanted, found):
                answer = found
        if not answer:
            answer = self._list()
            with suppress(OSError):
                if kept is not None:
                    kept.write_bytes(_seal(wanted, answer) + b"\n" + answer)
        known: dict[str, Any] = json.loads(answer)
        return known

    def _list(self) -> bytes:
        with launched(self._child, ("list", *self._arguments), stdout=subprocess.PIPE) as process:
            answer, _ = process.communicate()
        if process.returncode:
            raise Ended(_how(process.returncode))
        return answer

    def wants(self, numbers: Iterable[int]) -> None:
        """Say, before the first `read`, which images will be read; others are dropped as they come."""
        self._wanted = frozenset(numbers)

    def read(self, number: int) -> bytes:
        """An image, the same bytes each time. Images have to be read in about their order: only a few are kept.

        Raises
        ------
        Repeated
        ValueError
            It cannot be decoded.
        """
        with self._lock:
            while number not in self._kept and self._ended is None and number > self._last:
                self._receive()
            if number not in self._kept:
                raise ValueError(self._ended or "is damaged, or not of a kind that is read")
            image = self._kept[number]
            if self._first.setdefault(hashlib.sha256(image).digest(), number) != number:
                raise Repeated
            return image

    def close(self) -> None:
        """End its process; who reads meanwhile is told that no more images come."""
        if self._process is not None:
            self._process.kill()
        with self._lock:
            self._end()
            self._ended = "is not read any more"

    def _end(self) -> int:
        """Wait for the process to end; returns its code."""
        if self._process is None or self._process.stdout is None:
            return 0
        self._process.stdout.close()
        return self._process.wait()

    def _receive(self) -> None:
        """Keep the next image that is sent, or learn that there is none."""
        if self._process is None:
            self._process = launched(self._child, ("send", *self._arguments), stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        header = self._process.stdout.read(HEADER.size)
        if len(header) == HEADER.size:
            number, length = HEADER.unpack(header)
            image = self._process.stdout.read(length)
            if len(image) == length:
                self._last = number
                if self._wanted is None or number in self._wanted:
                    self._kept[number] = image
                return
        code = self._end()
        self._ended = f"cannot be read: {_how(code)}" if code else "is damaged, or the file breaks off before"


def _seal(wanted: bytes, answer: bytes) -> bytes:
    """Digest of a request and its answer."""
    return hashlib.sha256(wanted + b"\n" + answer).hexdigest().encode()


def _how(code: int) -> str:
    if code == -signal.SIGALRM:
        return "reading it took too long"
    return f"reading it ended its process ({signal.Signals(-code).name if code < 0 else f'code {code}'})"
