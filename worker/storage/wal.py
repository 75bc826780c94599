"""Whether the write-ahead log of a SQLite file is whole.

SQLite itself reads a log up to the first frame that does not fit its checksum and takes the rest for never written:
right after a power failure, and silent about commits that a damaged byte hides.

Source: https://sqlite.org/fileformat2.html, section 4 (WAL-mode file format).
"""

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from struct import Struct
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

_HEADER = Struct(">8I")  # magic, format, page size, sequence, two salts, two checksums
_FRAME = Struct(">6I")  # page, pages after a commit (0: none), two salts, two checksums
_MAGIC = (0x377F0682, 0x377F0683)

UNFINISHED = "its last frame is unfinished or damaged; if that was a commit, it is lost"
"""As a process that was killed while it wrote leaves it, so that nothing that was acknowledged needs to be missing."""


def fault(path: Path) -> str | None:
    """What is wrong with a log, or None; an absent or empty one is whole."""
    try:
        with path.open("rb") as log:
            return _fault(log, os.fstat(log.fileno()).st_size)
    except FileNotFoundError:
        return None


def _fault(log: BinaryIO, end: int) -> str | None:
    """The same of an open file of this length, which a long transaction makes as large as the database."""
    if end == 0:
        return None
    head = log.read(_HEADER.size)
    if len(head) < _HEADER.size:
        return "its header is cut off, so that none of its commits can be read"
    magic, _, page_size, _, *salts, first, second = _HEADER.unpack(head)
    order = "big" if magic & 1 else "little"
    if magic not in _MAGIC or _sums(head[:-8], (0, 0), order) != (first, second):
        return "its header is damaged, so that none of its commits can be read"
    sums = (first, second)
    size = _FRAME.size + page_size
    for number, start in enumerate(range(_HEADER.size, end, size), 1):
        frame = log.read(size)
        if len(frame) < _FRAME.size or list(_FRAME.unpack_from(frame)[2:4]) != salts:
            # The frames of an earlier round of the log follow, or a part of one: unless commits of this round do.
            if any(True for _ in _later(log, range(start + size, end - _FRAME.size, size), salts)):
                return f"frame {number} is damaged; commits after it cannot be read"
            return UNFINISHED if len(frame) < _FRAME.size else None
        found = _FRAME.unpack_from(frame)
        sums = _sums(frame[:8] + frame[_FRAME.size :], sums, order) if len(frame) == size else (-1, -1)
        if sums != tuple(found[4:]):
            later = list(_later(log, range(start + size, end - _FRAME.size, size), salts))
            if not later:
                return UNFINISHED
            if not found[1] and not any(later):
                return None  # of a transaction that never ended: it writes pages over, and their checksums at its end
            return f"frame {number} of {-(-(end - _HEADER.size) // size)} is damaged; commits from it on cannot be read"
    return None


def _later(log: BinaryIO, starts: range, salts: list[int]) -> Iterator[int]:
    """Of each later frame of the round with these salts the number of pages after a commit (0: none)."""
    for start in starts:
        log.seek(start)
        frame = log.read(_FRAME.size)
        if len(frame) == _FRAME.size and list(_FRAME.unpack(frame)[2:4]) == salts:
            yield int(_FRAME.unpack(frame)[1])


def _sums(data: bytes, sums: tuple[int, int], order: str) -> tuple[int, int]:
    """The checksums behind some bytes, from those before them.

    Each is the sum of the two before it and of the next 32-bit word ``x``: ``s[i] = s[i-2] + s[i-1] + x[i]``. So a word
    counts in the last one as often as the Fibonacci number of its distance from the end says.
    """
    words = np.frombuffer(data, ">u4" if order == "big" else "<u4").astype(np.uint32)
    count = len(words)
    numbers = _fibonacci(count)
    first, second = sums
    before, here, after = (int(number) for number in numbers[count - 1 :])
    last_but_one = int(words @ numbers[count - 1 :: -1]) + first * before + second * here
    last = int(words @ numbers[count:0:-1]) + first * here + second * after
    return last_but_one & 0xFFFFFFFF, last & 0xFFFFFFFF


@cache
def _fibonacci(count: int) -> npt.NDArray[np.uint32]:
    """Fibonacci numbers from the zeroth to the one of `count` + 1, of their lowest 32 bits, uint32."""
    numbers = [0, 1]
    while len(numbers) < count + 2:
        numbers.append((numbers[-2] + numbers[-1]) & 0xFFFFFFFF)
    return np.array(numbers, np.uint32)
