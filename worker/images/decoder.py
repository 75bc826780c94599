"""The port of everything that decodes clients' bytes, and the decoder without a process of its own."""

import io
from typing import Protocol

from schemas.errors import BadImage, BodyTooLarge
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

    def decode(self, data: bytes, *, patient: bool = False, stored: bool = False) -> Image:
        """An image upright, RGB, eight bits.

        Parameters
        ----------
        data : bytes
        patient : bool
            Whether it waits for its turn, and for a process, as long as it takes.
        stored : bool
            Whether it was accepted before. It may be larger than the limits then, which were others.

        Raises
        ------
        BadImage, BodyTooLarge
        Busy, Unavailable
            Not where it is patient, unless the service stops.
        """
        ...

    def thumbnail(self, data: bytes, longest: int) -> bytes:
        """A JPEG of an accepted image without metadata, upright, its longer side at most `longest` pixels.

        Raises
        ------
        BadImage, Busy, Unavailable
        """
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

    def decode(self, data: bytes, *, patient: bool = False, stored: bool = False) -> Image:
        """As `codec.decode`."""
        try:
            return codec.decode(data, self._limits)
        except (BadImage, BodyTooLarge) as error:
            if not stored or not codec.is_too_large(error):
                raise
        return codec.decode(data, codec.Limits.that_allow(data))

    def thumbnail(self, data: bytes, longest: int) -> bytes:
        """As `codec.thumbnail`."""
        return codec.thumbnail(data, longest)

    def read_exif(self, data: bytes) -> Known:
        """As `exif.read_exif`."""
        return exif.read_exif(io.BytesIO(data))

    def close(self) -> None:
        """Nothing to release."""
