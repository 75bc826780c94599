"""A decoded image."""

import hashlib
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Bytes2D = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Image:
    """An image as the method sees it: upright, RGB, eight bits.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    digest : str
        SHA-256 (hex) of the bytes it was decoded from; seeds everything random about it.
    format : str
        ``jpeg``, ``png``, ``webp``, ``bmp`` or ``tiff``.
    byte_count : int
        Length of the encoded image.
    """

    pixels: Bytes2D
    digest: str
    format: str = "png"
    byte_count: int = 0

    def __post_init__(self) -> None:
        if self.pixels.ndim != 3 or self.pixels.shape[2] != 3 or self.pixels.dtype != np.uint8:
            raise ValueError(f"a picture is uint8 (height, width, 3), not {self.pixels.dtype} {self.pixels.shape}")

    @classmethod
    def of(cls, pixels: Bytes2D) -> "Image":
        """An image that was drawn rather than decoded; its digest is that of its pixels."""
        return cls(np.ascontiguousarray(pixels), hashlib.sha256(pixels.tobytes()).hexdigest(), "png", pixels.nbytes)

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.pixels.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.pixels.shape[1])

    @property
    def extent(self) -> tuple[float, float]:
        """(width, height) as fractions of the longer side: the unit in which graph positions are given."""
        return extent_of(self.width, self.height)


def extent_of(width: int, height: int) -> tuple[float, float]:
    """(width, height) in pixels as fractions of the longer of both."""
    longer = max(width, height)
    return width / longer, height / longer


@dataclass(frozen=True)
class ImageFacts:
    """What is kept of an image besides its bytes."""

    width: int
    height: int
    byte_count: int
    format: str
    sha256: str = field(repr=False)
