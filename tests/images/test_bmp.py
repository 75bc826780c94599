"""BMP of 32 bits, whose last eight may be alpha or nothing at all."""

import io
import struct

import numpy as np
import pytest
from PIL import Image as PilImage

from tests.sample_images import drawn
from worker.images.codec import Limits, decode, thumbnail

LIMITS = Limits()


def bmp_of(pixels: np.ndarray, alpha: np.ndarray) -> bytes:
    """A BMP with the header that names a mask of alpha (BITMAPV4HEADER)."""
    height, width = pixels.shape[:2]
    rows = np.concatenate([pixels[::-1, :, ::-1], alpha[::-1, :, None]], axis=-1).astype(np.uint8).tobytes()
    masks = struct.pack("<IIII", 0xFF0000, 0xFF00, 0xFF, 0xFF000000).ljust(68, b"\0")
    header = struct.pack("<IiiHHIIiiII", 108, width, height, 1, 32, 3, len(rows), 0, 0, 0, 0) + masks
    return b"BM" + struct.pack("<IHHI", 14 + len(header) + len(rows), 0, 0, 14 + len(header)) + header + rows


@pytest.mark.parametrize("written", [0, 255])
def test_what_is_left_empty_all_over_makes_no_image_white(written: int) -> None:
    data = bmp_of(drawn(64, 48), np.full((48, 64), written))

    assert np.array_equal(decode(data, LIMITS).pixels, drawn(64, 48))
    small = np.asarray(PilImage.open(io.BytesIO(thumbnail(data, 64))).convert("RGB"))
    assert np.abs(small.astype(int) - drawn(64, 48)).mean() < 4


def test_what_is_partly_transparent_is_laid_over_white() -> None:
    alpha = np.full((48, 64), 255)
    alpha[:, :32] = 0

    pixels = decode(bmp_of(drawn(64, 48), alpha), LIMITS).pixels

    assert (pixels[:, :32] == 255).all()
    assert np.array_equal(pixels[:, 32:], drawn(64, 48)[:, 32:])
