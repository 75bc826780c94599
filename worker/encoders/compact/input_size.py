"""Input size of the compact network."""

import cv2
import numpy as np

from schemas.image import Bytes2D

LONGEST = 480
"""Pixels to which the longer side is resized; small images are enlarged, since labels depend on the scale."""

ENLARGED = 3.6
"""The smallest images are enlarged no more than so many times: further on, cells show what interpolation makes up."""

LEAST = 352
"""Pixels to which the longer side is resized at least: with fewer cells, neighbours on a path look alike."""

MULTIPLE = 32
"""Sides of the input are multiples of this many pixels, so that images need no padding."""


def longer_side(width: int, height: int) -> float:
    """Pixels that the longer side of an image should have in the input, from `LEAST` to `LONGEST`."""
    return min(LONGEST, max(LEAST, ENLARGED * max(width, height)))


def network_size(width: int, height: int, longest: float | None = None) -> tuple[int, int]:
    """Input (width, height) for an image: longer side about `longest`, both at least 96 and multiples of `MULTIPLE`.

    `longest` is `longer_side` where it is not given.
    """
    scale = (longer_side(width, height) if longest is None else longest) / max(width, height)
    across, down = (max(3, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width, height))
    return across, down


def resized(pixels: Bytes2D, longest: float | None = None) -> Bytes2D:
    """Resize an image, uint8 of shape (height, width, 3), to `network_size`."""
    height, width = pixels.shape[:2]
    size = network_size(width, height, longest)
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)
