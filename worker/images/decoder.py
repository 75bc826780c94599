"""The port of everything that decodes clients' bytes, and the decoder without a process of its own."""

import io
from typing import Protocol

from schemas.image import Image
from worker.images import codec, exif
from worker.images.exif import Known


class Decoder(Protocol):
    """Bytes to images. Safe to call from several threads at once."""

    @property
    def restarts(self) -> int:
        """Times that a process for decoding was started anew after its predecessor ended."""
        ...

    def start(self) -> None:
        """Get ready ahead of the first image."""
        ...

    def check(self) -> str:
        """``ok``, or why no image can be decoded now."""
        ...

    def decode(self, data: bytes) -> Image:
        """An image upright, RGB, eight bits; raises BadImage, BodyTooLarge, Busy, Unavailable."""
        ...

    def decode_patiently(self, data: bytes) -> Image:
        """As `decode`, of an image that was accepted before: waits for its turn instead of raising Busy."""
        ...

    def thumbnail(self, data: bytes, longest: int) -> bytes:
        """A JPEG without metadata, upright, its longer side at most `longest` pixels; raises as `decode`."""
        ...

    def read_exif(self, data: bytes) -> Known:
        """As `exif.read_exif`; raises BadImage, BodyTooLarge, Unavailable."""
        ...

    def close(self) -> None:
        """Release what it holds. Later calls raise Unavailable."""
        ...


class InProcessDecoder:
    """Decodes in the calling thread: quicker to start, but a crash of a codec ends the service.

    Parameters
    ----------
    limits : Limits
    """

    def __init__(self, limits: codec.Limits) -> None:
        self._limits = limits

    restarts = 0

    def start(self) -> None:
        """Nothing to do."""

    def check(self) -> str:
        """Always ``ok``."""
        return "ok"

    def decode(self, data: bytes) -> Image:
        """As `codec.decode`."""
        return codec.decode(data, self._limits)

    decode_patiently = decode

    def thumbnail(self, data: bytes, longest: int) -> bytes:
        """As `codec.thumbnail`."""
        return codec.thumbnail(data, longest)

    def read_exif(self, data: bytes) -> Known:
        """As `exif.read_exif`."""
        return exif.read_exif(io.BytesIO(data))

    def close(self) -> None:
        """Nothing to release."""
