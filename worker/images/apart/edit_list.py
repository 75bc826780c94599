"""How long an MP4 or QuickTime file shows its images (ISO/IEC 14496-12, 8.6.6).

A video that was cut without encoding it anew still has the packets that decoders need before the cut.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

MOST_BYTES = 64_000_000
"""Of the box ``moov``."""

MOST_BOXES = 10_000


def shown_s(path: Path) -> float | None:
    """Seconds by the edit list of its images; None where it has none, or is no such file."""
    try:
        moov = _moov(path)
        (scale,) = struct.unpack_from(">I", moov, _inside(moov, b"mvhd") + _VERSIONED[moov[_inside(moov, b"mvhd")]][0])
        for kind, begin, end in _boxes(moov, 0, len(moov)):
            if kind == b"trak":
                media = _inside(moov, b"mdia", begin, end)
                handler = _inside(moov, b"hdlr", media, end)
                if moov[handler + 8 : handler + 12] == b"vide":
                    units = _units(moov, _inside(moov, b"elst", _inside(moov, b"edts", begin, end), end))
                    return units / scale if units else None  # 0: to the end
    except (OSError, ValueError, LookupError, ZeroDivisionError, struct.error):
        return None
    return None


_VERSIONED = {0: (12, ">Ii", 12), 1: (20, ">Qq", 20)}
"""By version: where ``mvhd`` has its time scale; the form of an edit's duration and start, and the bytes of an edit."""


def _moov(path: Path) -> bytes:
    """The content of the box ``moov``; raises LookupError where there is none."""
    with path.open("rb") as file:
        for _ in range(MOST_BOXES):
            size, kind = struct.unpack(">I4s", file.read(8))
            begin = 8
            if size == 1:
                (size,) = struct.unpack(">Q", file.read(8))
                begin = 16
            if kind == b"moov":
                return file.read(min(size - begin, MOST_BYTES)) if size else file.read(MOST_BYTES)
            if size < begin:
                break
            file.seek(size - begin, 1)
    raise LookupError("moov")


def _boxes(data: bytes, begin: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, begin and end of the content of each box."""
    while begin + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, begin)
        if size < 8:
            return
        yield kind, begin + 8, min(begin + size, end)
        begin += size


def _inside(data: bytes, wanted: bytes, begin: int = 0, end: int | None = None) -> int:
    """Where the content of the first box of a kind begins; raises LookupError where there is none."""
    for kind, at, _ in _boxes(data, begin, len(data) if end is None else end):
        if kind == wanted:
            return at
    raise LookupError(wanted)


def _units(data: bytes, at: int) -> int:
    """Durations of all edits that show something, together."""
    _, form, size = _VERSIONED[data[at]]
    (count,) = struct.unpack_from(">I", data, at + 4)
    if at + 8 + count * size > len(data):
        raise ValueError(f"{count} edits are more than there are")
    edits = [struct.unpack_from(form, data, at + 8 + number * size) for number in range(count)]
    return sum(duration for duration, start in edits if start >= 0)
