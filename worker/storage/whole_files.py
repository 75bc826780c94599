"""Reading and writing whole files by as few calls of the system as can be: at each, threads wait for each other."""

import os
from collections.abc import Sequence
from pathlib import Path

MOST_PIECES = 1000
"""Pieces that are written by one call; systems take 1,024."""


def read(path: Path) -> bytes:
    """The bytes of a regular file; raises OSError."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(handle, os.fstat(handle).st_size)  # a regular file is read whole by one call
    finally:
        os.close(handle)


def write(handle: int, pieces: Sequence[bytes]) -> None:
    """Write all bytes of pieces, one after another, to an open file; raises OSError."""
    for at in range(0, len(pieces), MOST_PIECES):
        some = pieces[at : at + MOST_PIECES]
        written = os.writev(handle, some)
        if written < sum(map(len, some)):  # of very many bytes, or on a disk that is nearly full
            rest = memoryview(b"".join(some))[written:]
            while rest:
                rest = rest[os.write(handle, rest) :]
