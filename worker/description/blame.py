"""Whether an image is to blame for a failure of the encoder, or the encoder itself."""

from collections.abc import Iterator, Sequence

import numpy as np

from schemas.description import PixelField
from schemas.errors import EncoderAway, EncoderFails
from schemas.image import Image
from worker.description.ports import Encodes

PLAIN = Image(np.full((480, 640, 3), 127, np.uint8), "0" * 64)
"""An image that no encoder should fail on, of a usual size: it needs as much memory as those of callers."""

REST_S = 5
"""Seconds between attempts while the encoder fails."""


def encoded(encoder: Encodes, images: Sequence[Image], *, urgent: bool, name: str = "encoder") -> Iterator[PixelField]:
    """The fields of images, as `Encodes.encode` makes them.

    Where that fails, the encoder is tried on a plain image. If it fails there too, as on a GPU that is lost or without
    memory, these images would fail for nothing of their own. If it does not, they are tried once more: it may have got
    well between the two. `name` is what a refusal calls it.

    Raises
    ------
    EncoderFails
        It fails on a plain image as well.
    EncoderAway
        A shared encoder cannot be had now.
    Exception
        Whatever the encoder raised on these images, twice; ValueError where it gave numbers that are none.
    """
    done = 0
    try:
        for field in _sound(encoder, images, urgent=urgent):
            done += 1
            yield field
        return
    except EncoderAway:
        raise
    except Exception as error:
        try:
            for _ in _sound(encoder, [PLAIN], urgent=urgent):
                pass
        except EncoderAway:
            raise
        except Exception:
            raise EncoderFails(
                f"the {name} fails on every image ({type(error).__name__}); the service's log has the reason; "
                f"try again in {REST_S} s",
                REST_S,
            ) from error
    yield from _sound(encoder, images[done:], urgent=urgent)


def _sound(encoder: Encodes, images: Sequence[Image], *, urgent: bool) -> Iterator[PixelField]:
    """What an encoder makes of images; raises ValueError where that is no field, as half precision may overflow."""
    for field in encoder.encode(images, urgent=urgent):
        if not all(np.isfinite(layer.sum()) for layer in field.layers.values()):
            raise ValueError("the encoder gave vectors with numbers that are none")
        yield field
