"""Whether the write-ahead log of a SQLite file is whole.

SQLite itself reads a log up to the first frame that does not fit its checksum and takes the rest for never written:
right after a power failure, and silent about commits that a damaged byte hides.

Source: https://sqlite.org/fileformat2.html, section 4 (WAL-mode file format).
"""

from collections.abc import Iterator
from pathlib import Path
from struct import Struct

_HEADER = Struct(">8I")  # magic, format, page size, sequence, two salts, two checksums
_FRAME = Struct(">6I")  # page, pages after a commit (0: none), two salts, two checksums
_MAGIC = (0x377F0682, 0x377F0683)

UNFINISHED = "its last frame is unfinished or damaged; if that was a commit, it is lost"
"""As a process that was killed while it wrote leaves it, so that nothing that was acknowledged needs to be missing."""


def fault(path: Path) -> str | None:
    """What is wrong with a log, or None; an absent or empty one is whole."""
    try:
        log = path.read_bytes()
    except FileNotFoundError:
        return None
    if not log:
        return None
    if len(log) < _HEADER.size:
        return "its header is cut off, so that none of its commits can be read"
    magic, _, page_size, _, *salts, first, second = _HEADER.unpack_from(log)
    order = "big" if magic & 1 else "little"
    if magic not in _MAGIC or _sums(log[: _HEADER.size - 8], (0, 0), order) != (first, second):
        return "its header is damaged, so that none of its commits can be read"
    sums = (first, second)
    size = _FRAME.size + page_size
    for start in range(_HEADER.size, len(log), size):
        frame = log[start : start + size]
        if len(frame) < _FRAME.size or list(_FRAME.unpack_from(frame)[2:4]) != salts:
            # The frames of an earlier round of the log follow, or a part of one: unless commits of this round do.
            if _goes_on(log, start + size, size, salts):
                return f"frame {(start - _HEADER.size) // size + 1} is damaged; commits after it cannot be read"
            return UNFINISHED if len(frame) < _FRAME.size else None
        found = _FRAME.unpack_from(frame)
        sums = _sums(frame[:8] + frame[_FRAME.size :], sums, order) if len(frame) == size else (-1, -1)
        if sums != tuple(found[4:]):
            if not _goes_on(log, start + size, size, salts):
                return UNFINISHED
            return (
                f"frame {(start - _HEADER.size) // size + 1} of {-(-(len(log) - _HEADER.size) // size)} is damaged; "
                "commits from it on cannot be read"
            )
    return None


def _goes_on(log: bytes, start: int, size: int, salts: list[int]) -> bool:
    """Whether any later frame is of the round with these salts."""
    later = range(start, len(log) - _FRAME.size, size)
    return any(list(_FRAME.unpack_from(log, at)[2:4]) == salts for at in later)


def _sums(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    first, second = sums
    for one, other in _pairs(data, order):
        first = (first + one + second) & 0xFFFFFFFF
        second = (second + other + first) & 0xFFFFFFFF
    return first, second


def _pairs(data: bytes, order: str) -> Iterator[tuple[int, int]]:
    numbers = memoryview(data).cast("I") if order == "little" else Struct(f">{len(data) // 4}I").unpack(data)
    return zip(numbers[::2], numbers[1::2], strict=True)
