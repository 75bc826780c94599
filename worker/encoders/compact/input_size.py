"""Input size of the compact network."""

import cv2
import numpy as np

from schemas.image import Bytes2D

LONGEST = 480
"""Pixels to which the longer side is resized; small images are enlarged, since labels depend on the scale."""

MULTIPLE = 32
"""Sides of the input are multiples of this many pixels, so that images need no padding."""


def network_size(width: int, height: int, longest: float = LONGEST) -> tuple[int, int]:
    """Input (width, height) for an image: longer side about `longest`, both at least 96 and multiples of `MULTIPLE`."""
    scale = longest / max(width, height)
    across, down = (max(3, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width, height))
    return across, down


def resized(pixels: Bytes2D, longest: float = LONGEST) -> Bytes2D:
    """Resize an image, uint8 of shape (height, width, 3), to `network_size`."""
    height, width = pixels.shape[:2]
    size = network_size(width, height, longest)
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)
