"""Lets writes of a process fail, from the n-th on, with any error of a disk: see failing_writes.c."""

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.preloading import compiled

_LAYOUT = struct.Struct("4i")


class FailingWrites:
    """Controls the library in another process, or in this one when it was started with `environment`.

    Parameters
    ----------
    environment : mapping of str to str
        Variables of the process.
    control : Path
        File of the library's numbers.
    """

    def __init__(self, environment: dict[str, str], control: Path) -> None:
        self.environment = environment
        with control.open("r+b") as file:
            self._shared = mmap.mmap(file.fileno(), _LAYOUT.size)

    def fail(self, error: int, after: int = 1) -> None:
        """Let the `after`-th call from now and all following ones fail with an errno."""
        self._shared[:] = _LAYOUT.pack(0, after, 0, 0)
        self._shared[:] = _LAYOUT.pack(error, after, 0, 0)

    def end(self) -> int:
        """Let nothing fail any more; returns how many calls failed."""
        _, first, calls, failed = _LAYOUT.unpack(self._shared[:])
        self._shared[:] = _LAYOUT.pack(0, first, calls, failed)
        return int(failed)


@contextmanager
def failing_writes(folder: Path, under: Path | None = None) -> Iterator[FailingWrites]:
    """Control over the writes below `under`, by default ``data`` in the folder; skips where nothing can be compiled."""
    control = folder / "faults"
    control.write_bytes(bytes(_LAYOUT.size))
    library = compiled(Path(__file__).with_suffix(".c"), folder)
    environment = {
        "LD_PRELOAD": str(library),
        "FAULTS_CONTROL": str(control),
        "FAULTS_UNDER": str(under or folder / "data"),
    }
    yield FailingWrites(environment, control)
