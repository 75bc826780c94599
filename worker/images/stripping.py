"""Files without their metadata: the same pixels, orientation and colours; nothing that tells of the photographer.

Kept are what decoders need, ICC profiles, and an EXIF block with the orientation alone when it matters. Nothing is
encoded anew. A file that holds nothing else comes back as it is.
"""

import struct
from collections.abc import Callable

from worker.images import jpeg, png
from worker.images.codec import orientation
from worker.images.tiff import without_metadata as _tiff

_ICC = b"ICC_PROFILE\x00"
_TABLES = frozenset(range(0xC0, 0xE0))  # frames, tables, scans
_PNG = frozenset(b"IHDR PLTE IDAT IEND tRNS gAMA cHRM sRGB iCCP sBIT bKGD pHYs cICP".split())
_WEBP_PIXELS = frozenset((b"VP8 ", b"VP8L"))
_WEBP = _WEBP_PIXELS | {b"VP8X", b"ALPH", b"ICCP"}
_EXIF_FLAG, _XMP_FLAG = 0x08, 0x04  # of VP8X (RFC 9649, 2.7)

MOST_CHUNKS = 10_000
"""Chunks of a WebP that are followed: encoders write up to six, and the least has eight bytes."""


def strip(data: bytes, form: str) -> bytes:
    """The file without metadata and without anything behind the image.

    Parameters
    ----------
    data : bytes
        An image that `codec.decode` accepts.
    form : str
        ``jpeg``, ``png``, ``webp``, ``bmp`` or ``tiff``.

    Raises
    ------
    ValueError
        Its structure cannot be followed.
    """
    try:
        return _STRIP[form](data)
    except (struct.error, IndexError, KeyError, OSError) as error:
        raise ValueError(f"the structure of this {form} cannot be followed") from error


def _exif(turned: int) -> bytes:
    """A TIFF structure with one field: the orientation (Exif 2.32, 4.6.4)."""
    return b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, turned, 0, 0)


def _jpeg(data: bytes) -> bytes:
    structure = jpeg.Structure.read(data)
    if structure is None:
        raise ValueError("the segments of this JPEG do not follow one another")
    turned = orientation(data)
    exif = b"Exif\x00\x00" + _exif(turned)
    parts, lost = [data[:2]], len(data) > structure.end
    for segment in structure.segments:
        content = segment.content
        end = segment.end if segment.marker == jpeg.START_OF_SCAN else segment.start + 4 + len(content)
        lost = lost or end < segment.end  # bytes between two segments
        if segment.marker == 0xE1 and content == exif:
            continue  # one of ours
        if segment.marker == 0xE0 and content.startswith(b"JFIF\x00") and len(content) >= 14:
            parts.append(_segment(0xE0, content[:12] + b"\x00\x00"))  # without the thumbnail
            lost = lost or content[12:] != b"\x00\x00"
        elif (
            segment.marker in _TABLES
            or (segment.marker == 0xE2 and content.startswith(_ICC))
            or (segment.marker == 0xEE and content.startswith(b"Adobe"))
        ):
            parts.append(data[segment.start : end])
        else:
            lost = True
    if not lost:
        return data
    if turned != 1:
        first = 2 if len(parts) > 1 and parts[1].startswith(b"\xff\xe0") else 1
        parts.insert(first, _segment(0xE1, exif))
    stripped = b"".join(parts)
    return stripped + jpeg.EOI if structure.ended else stripped.rstrip(b"\xff") + jpeg.EOI


def _segment(marker: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content


def _png(data: bytes) -> bytes:
    turned = orientation(data)
    exif = _exif(turned)
    parts, length = [png.SIGNATURE], len(png.SIGNATURE)
    lost = False
    for kind, content in png.chunks(data):
        length += 12 + len(content)
        if kind in _PNG:
            parts.append(png.chunk(kind, content))
        elif not (kind == b"eXIf" and content == exif):
            lost = True
    if not lost and length == len(data):
        return data
    if turned != 1:
        parts.insert(2, png.chunk(b"eXIf", exif))  # behind IHDR
    return b"".join(parts)


def _webp(data: bytes) -> bytes:
    turned = orientation(data)
    exif = _exif(turned)
    end = min(len(data), 8 + int.from_bytes(data[4:8], "little"))
    at, kept, lost = 12, [], len(data) > end
    number = 0
    while at + 8 <= end:
        if (number := number + 1) > MOST_CHUNKS:
            raise ValueError(f"this WebP has more than {MOST_CHUNKS:,} chunks")
        kind, length = data[at : at + 4], int.from_bytes(data[at + 4 : at + 8], "little")
        content = data[at + 8 : min(at + 8 + length, end)]
        if kind in _WEBP:
            kept.append((kind, content))
        elif not (kind == b"EXIF" and content == exif):
            lost = True
        at += 8 + length + length % 2
    if not lost:
        return data
    if not any(kind in _WEBP_PIXELS for kind, _ in kept):
        raise ValueError("the pixels of this WebP are those of an animation's one frame")
    parts = []
    for kind, content in kept:
        if kind == b"VP8X":
            flags = content[0] & ~(_EXIF_FLAG | _XMP_FLAG) | (_EXIF_FLAG if turned != 1 else 0)
            content = bytes((flags,)) + content[1:]
        parts.append(_riff(kind, content))
    if turned != 1:
        parts.append(_riff(b"EXIF", exif))
    body = b"WEBP" + b"".join(parts)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _riff(kind: bytes, content: bytes) -> bytes:
    return kind + struct.pack("<I", len(content)) + content + b"\x00" * (len(content) % 2)


def _bmp(data: bytes) -> bytes:
    """Without what follows the pixels; only V5 headers name or embed a profile, which is taken off."""
    (start, header) = struct.unpack_from("<II", data, 10)
    if header == 12:
        width, height, _, bits = struct.unpack_from("<HHHH", data, 18)
        compression = size = 0
    else:
        width, height, _, bits, compression, size = struct.unpack_from("<iiHHII", data, 18)
    rows = (width * bits + 31) // 32 * 4 * abs(height)
    run_lengths = compression in (1, 2)
    if run_lengths and len(data) != start + size:
        raise ValueError("the run lengths of this BMP alone say where its pixels end")
    end = start + (size if run_lengths else rows)
    profile = header >= 124 and struct.unpack_from("<I", data, 14 + 112)[0] != 0
    if len(data) <= end and not profile:
        return data
    stripped = bytearray(data[:end])
    if profile:
        stripped[14 + 56 : 14 + 60] = b"BGRs"  # LCS_sRGB
        stripped[14 + 112 : 14 + 120] = bytes(8)
    stripped[2:6] = struct.pack("<I", len(stripped))
    return bytes(stripped)


_STRIP: dict[str, Callable[[bytes], bytes]] = {"jpeg": _jpeg, "png": _png, "webp": _webp, "bmp": _bmp, "tiff": _tiff}
