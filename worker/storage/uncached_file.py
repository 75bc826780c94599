"""A large new file, written past the system's cache: to copy all of it there takes longer than to make it."""

import errno
import fcntl
import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

SIZE = 4 * 1024 * 1024
"""Bytes that are written by one call: of a size and at an address that every disk takes."""


class Digest(Protocol):
    """What `hashlib` makes, as far as it is needed here."""

    def update(self, data: memoryview, /) -> None:
        """Take bytes into account."""
        ...


class UncachedFile:
    """A new file that is written from its beginning to its end, past the cache where the file system can do that.

    Parameters
    ----------
    path : Path
        Of a file that does not exist.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self.folder = path.parent
        self._handle = os.open(path, flags, 0o666)
        self._uncached = _set_uncached(self._handle, True)
        self._buffer = memoryview(mmap.mmap(-1, SIZE))  # begins with a page
        self._filled = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, raised: object, where: TracebackType | None) -> None:
        self._buffer.release()
        os.close(self._handle)

    def write(self, pieces: Sequence[bytes], digest: Digest | None = None) -> None:
        """Append bytes, and have a digest take them into account; raises OSError, also for what was given before."""
        begin = self._filled
        for piece in pieces:
            at = 0
            while at < len(piece):
                count = min(len(piece) - at, SIZE - self._filled)
                self._buffer[self._filled : self._filled + count] = memoryview(piece)[at : at + count]
                self._filled, at = self._filled + count, at + count
                if self._filled == SIZE:
                    if digest is not None:
                        digest.update(self._buffer[begin:])
                    self._empty()
                    begin = 0
        if digest is not None:
            digest.update(self._buffer[begin : self._filled])

    def replace(self, at: int, piece: bytes) -> None:
        """Write bytes over others, from that byte on; what is appended later goes through the cache."""
        self._end_uncached()
        self._empty()
        while piece:
            written = os.pwrite(self._handle, piece, at)
            piece, at = piece[written:], at + written

    def sync(self) -> None:
        """Wait until all is on the disk; raises OSError."""
        self._end_uncached()
        self._empty()
        os.fsync(self._handle)

    def _empty(self) -> None:
        """Write what the buffer holds."""
        rest = self._buffer[: self._filled]
        while rest:
            try:
                rest = rest[os.write(self._handle, rest) :]
            except OSError as error:
                # A file system that takes the flag, but not the writing; or only a part was taken, as by a full disk.
                if error.errno != errno.EINVAL or not self._uncached:
                    raise
                self._end_uncached()
        self._filled = 0

    def _end_uncached(self) -> None:
        if self._uncached:
            _set_uncached(self._handle, False)
            self._uncached = False


def _set_uncached(handle: int, uncached: bool) -> bool:
    """Write a file past the cache, or through it; returns whether it is past it."""
    if not hasattr(os, "O_DIRECT"):  # macOS
        return False
    flags = fcntl.fcntl(handle, fcntl.F_GETFL)
    try:
        fcntl.fcntl(handle, fcntl.F_SETFL, flags | os.O_DIRECT if uncached else flags & ~os.O_DIRECT)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        return False
    return uncached
