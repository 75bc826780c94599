"""An image as a camera with another field of view would have taken it from the same spot."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np

from schemas.image import Bytes2D, Image

LARGEST = 4.0
"""Zooms are from the inverse of this to this: beyond it hardly anything is left to compare."""

LONGEST = 1280
"""Pixels of the longer side of a framed image at most: no part of the method looks at more."""


def framed(image: Image, zoom: float) -> Image:
    """The image as a camera would have taken it that shows things at their size divided by `zoom`.

    Parameters
    ----------
    image : Image
    zoom : float
        1/`LARGEST`..`LARGEST`. Above 1 the image becomes the middle of a larger one of the same shape, around which it
        is mirrored: the network sees no edge, and nothing that it does not know. Below 1 its middle is left.

    Returns
    -------
    Image
        With a digest of its own, unless `zoom` is 1.

    Notes
    -----
    With fields of view a of the image's camera and b of the other one, both along the longer side and without
    distortion, zoom = tan(b / 2) / tan(a / 2).
    """
    if zoom == 1:
        return image
    pixels = _surrounded(image.pixels, zoom) if zoom > 1 else _middle(image.pixels, zoom)
    return replace(image, pixels=pixels, digest=hashlib.sha256(f"{image.digest} {zoom!r}".encode()).hexdigest())


def _middle(pixels: Bytes2D, share: float) -> Bytes2D:
    """So much of either side around the centre."""
    height, width = (max(1, round(side * share)) for side in pixels.shape[:2])
    top, left = (pixels.shape[0] - height) // 2, (pixels.shape[1] - width) // 2
    return _resized(pixels[top : top + height, left : left + width], min(1, LONGEST / max(height, width)))


def _surrounded(pixels: Bytes2D, zoom: float) -> Bytes2D:
    """The image in the middle of one whose sides are longer by `zoom`."""
    scale = min(1, LONGEST / zoom / max(pixels.shape))
    height, width = (max(1, round(side * scale * zoom)) for side in pixels.shape[:2])
    shown = _resized(pixels, scale)
    rows, columns = shown.shape[:2]
    top, left = (height - rows) // 2, (width - columns) // 2
    sides = top, height - rows - top, left, width - columns - left
    return np.asarray(cv2.copyMakeBorder(shown, *sides, cv2.BORDER_REFLECT), np.uint8)


def _resized(pixels: Bytes2D, scale: float) -> Bytes2D:
    """The image shrunk by a scale, which is at most 1."""
    rows, columns = (max(1, round(side * scale)) for side in pixels.shape[:2])
    return np.ascontiguousarray(cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
