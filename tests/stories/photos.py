"""What stories show the service: drawn places as a camera would save them."""

import io

from PIL import Image

from worker.scenes.scene import Scene


def photo(look: Scene) -> bytes:
    """A JPEG of a scene."""
    buffer = io.BytesIO()
    Image.fromarray(look.pixels).save(buffer, "JPEG", quality=92)
    return buffer.getvalue()
