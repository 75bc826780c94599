"""The images that the golden tests enrol and query with, by name.

Drawn places lie beside this file as JPEG, because another processor draws a few pixels differently, which changes
answers. Patches of colour are computed, and saved in formats that every library writes alike.
"""

import io
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from tests.golden.adapter import Pixels, blobs, encoded

FOLDER = Path(__file__).with_name("images")
GREY = 128


def file_of(name: str) -> Path:
    """The file of a drawn image."""
    return FOLDER / (re.sub(r"[^a-z0-9]+", "-", name) + ".jpg")


@cache
def image(name: str) -> bytes:
    """The bytes of an image file."""
    return COMPUTED[name]() if name in COMPUTED else file_of(name).read_bytes()


def _pixels(name: str) -> Pixels:
    return np.asarray(Image.open(io.BytesIO(image(name))))


def _checks() -> Pixels:
    """Black and white diagonal stripes."""
    bright = np.indices((192, 256)).sum(axis=0) // 16 % 2 * 255
    return np.repeat(bright.astype(np.uint8)[..., None], 3, axis=2)


COMPUTED: Mapping[str, Callable[[], bytes]] = {
    # the pixels of one image in other bytes
    "lane, as bmp": lambda: encoded(_pixels("lane"), "bmp"),
    "lane, as tiff": lambda: encoded(_pixels("lane"), "tiff"),
    "no picture": lambda: b"<svg/>",
    "stamp": lambda: encoded(blobs(16, 16), "bmp"),
    "wall": lambda: encoded(np.full((192, 256, 3), GREY, np.uint8), "bmp"),
    "white wall": lambda: encoded(np.full((192, 256, 3), 250, np.uint8), "bmp"),
    "checks": lambda: encoded(_checks(), "bmp"),
    **{f"blobs {seed}": lambda seed=seed: encoded(blobs(160, 120, seed), "bmp") for seed in range(8)},  # type: ignore[misc]
    # few pixels, so quickly described
    **{f"strip {seed}": lambda seed=seed: encoded(blobs(160, 40, seed), "bmp") for seed in range(7)},  # type: ignore[misc]
    "strip 1, cut": lambda: encoded(blobs(160, 40, 1)[2:36, 9:152], "bmp"),
    "blobs 1, cut": lambda: encoded(blobs(160, 120, 1)[8:112, 12:150], "bmp"),
    "blobs 2, darker": lambda: encoded(blobs(160, 120, 2) // 2, "bmp"),
}
