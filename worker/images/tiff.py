"""The structure of a TIFF file (TIFF 6.0, sections 2 and 15): fields of its first page; nothing is decoded."""

import struct
from dataclasses import dataclass

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
_LENGTHS = {3: "H", 4: "I"}
_STRIPS, _TILES = (273, 279), (324, 325)  # offsets, byte counts

# What decoders need: size, depth, compression, colours, strips, tiles, tables, samples and their range, orientation,
# ICC profile.
_KEPT = frozenset(
    (254, 256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 281, 282, 283, 284, 292, 293, 296, 301, 317, 318, 319)
) | frozenset((320, 322, 323, 324, 325, 332, 334, 336, 338, 339, 340, 341, 347, 529, 530, 531, 532, 34675))
_SAMPLES = 277  # SamplesPerPixel
_OF_EACH_PLANE = frozenset((256, 257, 259, 266, 274, 278, 317, 322, 323))
_GREY = ((258, 16), (262, 1), (_SAMPLES, 1))  # of what of each pixel: sixteen bits, 0 is black, one sample
_OVER = "parts of this TIFF lie over one another"

MOST_PIECES = 200_000
"""Strips or tiles that are followed: as many as the rows of three colours that lie apart, or the least tiles of the
largest image."""


def without_metadata(data: bytes) -> bytes:
    """The first page alone, with the fields that decoders need; the file itself when it holds nothing else.

    Raises
    ------
    ValueError
        A field or a strip lies outside the file, they lie over one another, or the compression keeps its data elsewhere
        (old JPEG).
    struct.error
        The file is too short.
    """
    page = _Page.read(data)
    last = max([page.last, *(begin + size for begin, size in page.pieces)])
    if not page.lost and len(data) <= last + 1:
        return data
    return _written(page.order, page.fields, (page.tags[0], [_slice(data, *piece) for piece in page.pieces]))


def plane(data: bytes, number: int) -> bytes:
    """One colour, of sixteen bits, of an image whose colours lie apart, as a grey image.

    Raises as `without_metadata`, and LookupError where the file does not say how many there are.
    """
    page = _Page.read(data)
    (colours,) = _numbers(page.order, page.fields[_SAMPLES])
    count = len(page.pieces) // colours
    pieces = page.pieces[number * count : (number + 1) * count]
    fields = {tag: field for tag, field in page.fields.items() if tag in _OF_EACH_PLANE}
    fields |= {tag: (3, 1, struct.pack(page.order + "H", value)) for tag, value in _GREY}
    fields[page.tags[1]] = (4, count, struct.pack(f"{page.order}{count}I", *(size for _, size in pieces)))
    return _written(page.order, fields, (page.tags[0], [_slice(data, *piece) for piece in pieces]))


@dataclass(frozen=True)
class _Page:
    """The first page: its order of bytes, kept fields, which tags say where its strips or tiles are, begin and size of
    each of these, where all but these ends, and whether there is more than is kept."""

    order: str
    fields: dict[int, tuple[int, int, bytes]]
    tags: tuple[int, int]
    pieces: list[tuple[int, int]]
    last: int
    lost: bool

    @classmethod
    def read(cls, data: bytes) -> "_Page":
        """Raises as `without_metadata`."""
        order = "<" if data[:2] == b"II" else ">"
        (at,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, at)
        (following,) = struct.unpack_from(order + "I", data, at + 2 + 12 * count)
        fields: dict[int, tuple[int, int, bytes]] = {}
        last = at + 6 + 12 * count
        stated = [(0, 8), (at, 6 + 12 * count)]  # begin and size of what is referred to
        left = len(data)  # bytes that fields and strips may still have; lying over one another they could have any
        lost = following != 0
        for number in range(count):
            tag, kind, length = struct.unpack_from(order + "HHI", data, at + 2 + 12 * number)
            if tag not in _KEPT or kind not in _SIZES:
                lost = True
                continue
            begin, size = at + 10 + 12 * number, _SIZES[kind] * length
            if size > 4:
                (begin,) = struct.unpack_from(order + "I", data, begin)
                stated.append((begin, size))
            last, left = max(last, begin + size), left - size
            if left < 0:
                raise ValueError(_OVER)
            fields[tag] = (kind, length, _slice(data, begin, size))
        offsets, lengths = tags = _TILES if _TILES[0] in fields else _STRIPS
        if offsets not in fields or lengths not in fields:
            raise ValueError("this TIFF does not say where its pixels are")
        if max(fields[offsets][1], fields[lengths][1]) > MOST_PIECES:
            raise ValueError(f"this TIFF has more than {MOST_PIECES:,} strips or tiles")
        if _numbers(order, fields.get(259, (3, 1, struct.pack(order + "H", 1))))[:1] == (6,):
            raise ValueError("this TIFF has JPEG data of the old kind")
        pieces = list(zip(_numbers(order, fields[offsets]), _numbers(order, fields[lengths]), strict=True))
        if sum(size for _, size in pieces) > left:
            raise ValueError(_OVER)
        return cls(order, fields, tags, pieces, last, lost or _hides(data, [*stated, *pieces]))


def _written(order: str, fields: dict[int, tuple[int, int, bytes]], pixels: tuple[int, list[bytes]]) -> bytes:
    """A file of these fields: directory, long values, strips or tiles."""
    tag, pieces = pixels
    fields = {**fields, tag: (4, len(pieces), bytes(4 * len(pieces)))}
    start = 8 + 6 + 12 * len(fields)
    room = start + sum(_even(len(value)) for _, _, value in fields.values() if len(value) > 4)
    places = []
    for piece in pieces:
        places.append(room)
        room += _even(len(piece))
    fields[tag] = (4, len(pieces), struct.pack(f"{order}{len(places)}I", *places))
    directory, values = struct.pack(order + "H", len(fields)), b""
    for number, (kind, length, value) in sorted(fields.items()):
        directory += struct.pack(order + "HHI", number, kind, length)
        if len(value) <= 4:
            directory += value.ljust(4, b"\x00")
        else:
            directory += struct.pack(order + "I", start + len(values))
            values += value.ljust(_even(len(value)), b"\x00")
    magic = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    padded = (piece.ljust(_even(len(piece)), b"\x00") for piece in pieces)
    return b"".join((magic, directory, bytes(4), values, *padded))


def _numbers(order: str, field: tuple[int, int, bytes]) -> tuple[int, ...]:
    kind, length, value = field
    if kind not in _LENGTHS:
        raise ValueError("this TIFF counts in an unknown way")
    return struct.unpack(f"{order}{length}{_LENGTHS[kind]}", value)


def _slice(data: bytes, begin: int, size: int) -> bytes:
    if not 0 <= begin <= begin + size <= len(data):
        raise ValueError("this TIFF refers to what is not in the file")
    return data[begin : begin + size]


def _hides(data: bytes, stated: list[tuple[int, int]]) -> bool:
    """Whether anything stands between what a file refers to: programs that change a field leave the old ones there."""
    end = 0
    for begin, size in sorted(stated):
        if data[end:begin].strip(b"\x00"):
            return True
        end = max(end, begin + size)
    return False


def _even(length: int) -> int:
    return length + length % 2
