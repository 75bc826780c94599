"""What stories show the service: drawn places as a camera would save them."""

import io

from PIL import Image

from schemas.picture import Bytes2D
from worker.scenes.scene import Scene


def photo(look: Scene) -> bytes:
    """A JPEG of a scene."""
    return jpeg(look.pixels)


def jpeg(pixels: Bytes2D) -> bytes:
    """A JPEG of RGB pixels."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=92)
    return buffer.getvalue()
