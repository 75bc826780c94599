"""The structure of a JPEG file, ITU-T T.81 annex B: segments, scans, the end; nothing is decoded."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

START_OF_SCAN, END_OF_IMAGE = 0xDA, 0xD9
EOI = b"\xff\xd9"

MOST_SCANS = 100
"""Scans accepted in one image. Encoders write about ten; each costs a pass over all of its blocks."""

MOST_SEGMENTS = 10_000
"""Segments accepted in one image: cameras write tens, with gigantic metadata hundreds, and the least has four bytes."""

# A marker other than a stuffed zero, a restart or a fill byte ends entropy-coded data.
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
# Segments before the end: tables, frames, scans, application data, comments. Any other marker is damage, at which
# decoders would stop and return an incomplete image.
_SEGMENTS = frozenset({*range(0xC0, 0xD0), *range(0xDA, 0xDE), *range(0xE0, 0xF0), 0xFE} - {0xC8})
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_COEFFICIENTS = frozenset(range(64))


@dataclass(frozen=True)
class Segment:
    """A marker segment, and the entropy-coded data behind it when it begins a scan.

    Parameters
    ----------
    marker : int
        Second byte of the marker.
    content : bytes
        Without the marker and the length.
    start, end : int
        Offsets of the marker and of the next marker.
    """

    marker: int
    content: bytes
    start: int
    end: int


@dataclass(frozen=True)
class Structure:
    """The segments of an image up to its end.

    Parameters
    ----------
    segments : tuple of Segment
    end : int
        Offset behind the image: what follows is no part of it.
    ended : bool
        Whether the end-of-image marker is there.
    """

    segments: tuple[Segment, ...]
    end: int
    ended: bool

    @classmethod
    def read(cls, data: bytes) -> "Structure | None":
        """The structure of an image; None when segments do not follow one another, or end amid the tables.

        Searching for the end's marker alone is not enough: the thumbnail in the EXIF block has one too.

        Raises
        ------
        ValueError
            There are more than `MOST_SEGMENTS`.
        """
        segments: list[Segment] = []
        match = _MARKER.search(data, 2)
        while match:
            marker, start, content = data[match.end() - 1], match.start(), match.end() + 2
            if marker == END_OF_IMAGE:
                return cls(tuple(segments), match.end(), True)
            end = match.end() + int.from_bytes(data[match.end() : content], "big")
            if marker not in _SEGMENTS or not content <= end <= len(data):
                return None
            if len(segments) == MOST_SEGMENTS:
                raise ValueError(f"it has more than {MOST_SEGMENTS:,} segments")
            match = _MARKER.search(data, end)
            segments.append(Segment(marker, data[content:end], start, match.start() if match else len(data)))
        if not segments or segments[-1].marker != START_OF_SCAN:
            return None
        return cls(tuple(segments), len(data), False)

    @property
    def scans(self) -> int:
        """Number of scans."""
        return sum(segment.marker == START_OF_SCAN for segment in self.segments)

    def has_every_scan(self) -> bool:
        """Whether the scans, if each is complete, hold every coefficient of every component to its last bit.

        Without an end-of-image marker nothing else tells whether more scans were to come.
        """
        wanted: set[int] = set()
        exact: dict[int, set[int]] = {}
        for segment in self.segments:
            if segment.marker in _FRAMES and len(segment.content) >= 6:
                wanted |= set(segment.content[6::3])
            elif segment.marker == START_OF_SCAN:
                for component, coefficients in _exact(segment.content):
                    exact.setdefault(component, set()).update(coefficients)
        return bool(wanted) and all(exact.get(component, set()) >= _COEFFICIENTS for component in wanted)


def _exact(header: bytes) -> Iterator[tuple[int, range]]:
    """Of a scan: each component and the coefficients that it gives to the last bit (T.81, B.2.3)."""
    count = header[0] if header else 0
    if len(header) < 4 + 2 * count:
        return
    first, last, approximation = header[1 + 2 * count : 4 + 2 * count]
    if approximation & 0x0F == 0:
        for component in header[1 : 1 + 2 * count : 2]:
            yield component, range(first, last + 1)


def ended(data: bytes, structure: Structure) -> bytes:
    """The file with an end-of-image marker, which some cameras leave out."""
    # A cut may fall between the marker's two bytes.
    return data if structure.ended else data.rstrip(b"\xff") + EOI


def without_padding(data: bytes, structure: Structure) -> bytes:
    """The image alone, without the zeros with which some cameras pad the last scan."""
    whole = data[: structure.end - 2] if structure.ended else data
    stem = whole.rstrip(b"\x00")
    if stem.endswith(b"\xff") and len(stem) < len(whole):
        stem += b"\x00"  # a byte 0xFF of the scan, which a zero must follow
    return stem + EOI
