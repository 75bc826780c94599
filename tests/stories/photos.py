"""What stories show the service: drawn places as a camera would save them."""

import io
from functools import lru_cache

import numpy as np
from PIL import Image as PilImage

from scenes.scene import Scene
from schemas.image import Bytes2D


@lru_cache(maxsize=2048)  # stories are told on two databases, and many of them of the same places
def photo(look: Scene) -> bytes:
    """A JPEG of a scene."""
    return jpeg(look.pixels)


def middle(pixels: Bytes2D, share: float) -> Bytes2D:
    """What a camera sees of an image whose field of view is narrower."""
    height, width = (round(side * share) for side in pixels.shape[:2])
    top, left = (pixels.shape[0] - height) // 2, (pixels.shape[1] - width) // 2
    return np.ascontiguousarray(pixels[top : top + height, left : left + width])


def jpeg(pixels: Bytes2D, quality: int = 92) -> bytes:
    """A JPEG of RGB pixels."""
    buffer = io.BytesIO()
    PilImage.fromarray(pixels).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()
