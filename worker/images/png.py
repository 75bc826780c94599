"""The structure of a PNG file (PNG, third edition, section 5): its chunks; nothing is decoded."""

import struct
import zlib
from collections.abc import Iterator

SIGNATURE = b"\x89PNG\r\n\x1a\n"

MOST_CHUNKS = 50_000
"""Chunks accepted in one image: encoders write pixels in pieces of 8 kB and more, and the least chunk has 12 bytes."""


def chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of a PNG's chunks, in order, up to IEND or the end of an incomplete file."""
    at = len(SIGNATURE)
    while at + 12 <= len(data):
        kind, length = data[at + 4 : at + 8], int.from_bytes(data[at : at + 4], "big")
        yield kind, data[at + 8 : at + 8 + length]
        if kind == b"IEND":
            return
        at += 12 + length


def chunk(kind: bytes, content: bytes) -> bytes:
    """One chunk with its length and checksum."""
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def depth(data: bytes) -> int:
    """Bits of a sample, by IHDR."""
    return data[24]


def is_whole(data: bytes) -> bool:
    """Whether the chunks are complete up to IEND; raises ValueError for more than `MOST_CHUNKS`."""
    for number, (kind, _) in enumerate(chunks(data)):
        if kind == b"IEND":
            return True
        if number == MOST_CHUNKS:
            raise ValueError(f"it has more than {MOST_CHUNKS:,} chunks")
    return False


def is_animated(data: bytes) -> bool:
    """Whether there is more than one image: several frames, or frames besides the default image (section 4.9).

    A single frame that is the default image itself is a still image.
    """
    for kind, content in chunks(data):
        if kind == b"fdAT" or (kind == b"acTL" and content[:4] not in (b"\x00\x00\x00\x00", b"\x00\x00\x00\x01")):
            return True
    return False
