"""The size at which the compact network sees an image."""

import cv2
import numpy as np

from schemas.image import Bytes2D

LONGEST = 480
"""Images are brought to this many pixels on the longer side: smaller ones too, since labels need the scale."""

MULTIPLE = 32
"""Sides become multiples of the network's deepest stride, so that nothing is padded."""


def network_size(width: int, height: int, longest: float = LONGEST) -> tuple[int, int]:
    """(width, height) at which the network sees an image: longer side about `longest`, both multiples of MULTIPLE."""
    scale = longest / max(width, height)
    across, down = (max(3, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width, height))
    return across, down


def resized(pixels: Bytes2D, longest: float = LONGEST) -> Bytes2D:
    """Bring an image, uint8 of shape (height, width, 3), to the size at which the network sees it."""
    height, width = pixels.shape[:2]
    size = network_size(width, height, longest)
    how = cv2.INTER_AREA if size[0] < width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)
