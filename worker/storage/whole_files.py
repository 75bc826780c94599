"""Reading and writing whole files by as few calls of the system as can be: at each, threads wait for each other."""

import os
from pathlib import Path


def read(path: Path | str) -> bytes:
    """The bytes of a regular file; raises OSError."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(handle, os.fstat(handle).st_size)  # a regular file is read whole by one call
    finally:
        os.close(handle)


def write(handle: int, body: bytes) -> None:
    """Write all of some bytes to an open file; raises OSError."""
    rest = memoryview(body)
    while rest:  # of very many bytes, or on a disk that is nearly full, a part is written
        rest = rest[os.write(handle, rest) :]
