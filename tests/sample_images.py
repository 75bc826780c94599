"""Images that tests draw, and the bytes they send."""

import io
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def drawn(width: int, height: int, seed: int = 0) -> npt.NDArray[np.uint8]:
    """Smooth coloured blobs, uint8 (height, width, 3): survives JPEG, has no symmetry, differs by seed."""
    coarse = np.random.default_rng(seed).integers(0, 256, (4, 5, 3), np.uint8)
    return np.asarray(PilImage.fromarray(coarse).resize((width, height), PilImage.Resampling.BICUBIC))


def encoded(pixels: npt.NDArray[np.uint8], form: str = "jpeg", **options: Any) -> bytes:
    """The pixels as bytes of a format that Pillow writes."""
    out = io.BytesIO()
    if form == "jpeg":
        options = {"quality": 95, "subsampling": 0} | options
    PilImage.fromarray(pixels).save(out, form, **options)
    return out.getvalue()


def photo(seed: int = 0, form: str = "jpeg") -> bytes:
    """A small encoded image; another seed is another place."""
    return encoded(drawn(64, 48, seed), form)


def png_chunk(kind: bytes, body: bytes) -> bytes:
    """One chunk of a PNG with its length and checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def exif_of_a_phone() -> PilImage.Exif:
    """Taken at 27.4 south, 153 east, facing east, on 4 May 2026 at 9:30 UTC."""
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "S", 2: (27.0, 24.0, 0.0), 3: "E", 4: (153.0, 0.0, 0.0), 16: "T", 17: 90.0})
    exif.get_ifd(0x8825).update({29: "2026:05:04", 7: (9.0, 30.0, 0.0)})
    return exif
