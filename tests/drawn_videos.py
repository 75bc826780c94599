"""Videos of drawn images, for tests."""

import struct
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tests.sample_images import drawn


def frames(count: int, size: int = 96) -> list[npt.NDArray[np.uint8]]:
    """Drawings of different places, BGR."""
    return [np.ascontiguousarray(drawn(size, size, i)[..., ::-1]) for i in range(count)]


def video(path: Path, images: Sequence[npt.NDArray[np.uint8]], per_second: float, codec: str = "MJPG") -> bytes:
    """The bytes of a video; its container follows from the ending of the path."""
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), per_second, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return path.read_bytes()


def cut(mp4: bytes, start_s: float, length_s: float) -> bytes:
    """An MP4 of OpenCV that is cut by its edit list alone, as `ffmpeg -c copy` and phones cut it."""
    (of_movie,), (of_media,) = (struct.unpack_from(">I", mp4, _box(mp4, path)[0] + 20) for path in (MVHD, MDHD))
    edit = struct.pack(">IiHH", round(length_s * of_movie), round(start_s * of_media), 1, 0)
    return _with(mp4, EDTS, _boxed(b"edts", _boxed(b"elst", struct.pack(">II", 0, 1) + edit)))


def uneven(mp4: bytes, shares: Sequence[float]) -> bytes:
    """An MP4 of OpenCV whose frames are shown for these shares of what they were, again and again."""
    count, each = struct.unpack_from(">II", mp4, _box(mp4, STTS)[0] + 16)
    lasting = [
        struct.pack(">II", 1, round(each * share)) for share, _ in zip(cycle(shares), range(count), strict=False)
    ]
    return _with(mp4, STTS, _boxed(b"stts", struct.pack(">II", 0, count) + b"".join(lasting)))


def turned(mp4: bytes, degrees: int) -> bytes:
    """An MP4 of OpenCV whose frames are to be shown turned clockwise, as phones write it; a multiple of 90."""
    quarter = degrees // 90 % 4
    cosine, sine = (1, 0, -1, 0)[quarter], (0, 1, 0, -1)[quarter]
    whole = bytearray(mp4)
    struct.pack_into(">4i", whole, _box(mp4, TKHD)[0] + 48, cosine << 16, sine << 16, 0, -sine << 16)
    struct.pack_into(">i", whole, _box(mp4, TKHD)[0] + 64, cosine << 16)
    return bytes(whole)


MVHD, TRAK = (b"moov", b"mvhd"), (b"moov", b"trak")
TKHD = (*TRAK, b"tkhd")
EDTS, MDHD = (*TRAK, b"edts"), (*TRAK, b"mdia", b"mdhd")
STTS = (*TRAK, b"mdia", b"minf", b"stbl", b"stts")


def _boxed(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def _box(mp4: bytes, path: Sequence[bytes]) -> tuple[int, int]:
    """Where a box begins and ends."""
    begin, end = 0, len(mp4)
    for depth, wanted in enumerate(path):
        begin += 8 * (depth > 0)
        while (kind := struct.unpack_from(">I4s", mp4, begin))[1] != wanted:
            begin += kind[0]
            assert begin < end, f"no {wanted!r}"
        end = begin + kind[0]
    return begin, end


def _with(mp4: bytes, path: Sequence[bytes], box: bytes) -> bytes:
    """The file with another box in the place of one behind which no offsets lead."""
    begin, end = _box(mp4, path)
    whole = bytearray(mp4[:begin] + box + mp4[end:])
    for depth in range(1, len(path)):
        at, until = _box(mp4, path[:depth])
        struct.pack_into(">I", whole, at, until - at + len(box) - (end - begin))
    return bytes(whole)
