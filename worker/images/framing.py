"""An image as the map's camera, held level, would have taken it from the same spot."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np

from schemas.image import Bytes2D, Image

LONGEST = 1280
"""Pixels of the longer side of a framed image at most: no part of the method looks at more."""


def framed(image: Image, zoom: float = 1.0, roll: float = 0.0) -> Image:
    """The image as a level camera would have taken it that shows things at their size divided by `zoom`.

    Parameters
    ----------
    image : Image
    zoom : float
        1/`values.LARGEST_ZOOM`..`values.LARGEST_ZOOM`. Above 1 the image becomes the middle of a larger one of the same
        shape, below 1 its middle is left.
    roll : float
        Degrees by which the camera was turned clockwise around its line of sight, looking along it; -180..180. From 45
        to 135 either way it was held on end, and the sides are exchanged.

    Returns
    -------
    Image
        With a digest of its own, unless nothing changes. Around what was seen it is mirrored: the network sees no edge,
        and nothing that it does not know.

    Notes
    -----
    With fields of view a of the image's camera and b of the other one, both along the longer side and without
    distortion, zoom = tan(b / 2) / tan(a / 2).
    """
    if zoom == 1 and roll == 0:
        return image
    digest = hashlib.sha256(f"{image.digest} {zoom!r} {roll!r}".encode()).hexdigest()
    return replace(image, pixels=_moved(image.pixels, zoom, roll), digest=digest)


def _moved(pixels: Bytes2D, zoom: float, roll: float) -> Bytes2D:
    """The image turned around its centre, on sides that are longer by `zoom`."""
    scale = min(1, LONGEST / zoom / max(pixels.shape[:2]))
    rows, columns = (max(1, round(side * scale)) for side in pixels.shape[:2])
    shown = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
    height, width = (max(1, round(side * scale * zoom)) for side in pixels.shape[:2])
    if 45 < abs(roll) < 135:  # held on end
        height, width = width, height
    motion = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -roll, 1.0)
    motion[:, 2] += (width - columns) // 2, (height - rows) // 2
    return np.asarray(cv2.warpAffine(shown, motion, (width, height), borderMode=cv2.BORDER_REFLECT), np.uint8)
