"""A decoded image."""

import hashlib
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Bytes2D = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Image:
    """A decoded image: upright, RGB, eight bits.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    digest : str
        SHA-256 (hex) of the encoded bytes; seeds the sampling of its descriptors.
    format : str
        ``jpeg``, ``png``, ``webp``, ``bmp``, ``tiff`` or ``heic``.
    byte_count : int
        Length of the encoded bytes.
    """

    pixels: Bytes2D
    digest: str
    format: str = "png"
    byte_count: int = 0

    def __post_init__(self) -> None:
        if self.pixels.ndim != 3 or self.pixels.shape[2] != 3 or self.pixels.dtype != np.uint8:
            raise ValueError(f"an image is uint8 (height, width, 3), not {self.pixels.dtype} {self.pixels.shape}")

    @classmethod
    def of(cls, pixels: Bytes2D) -> "Image":
        """An image from pixels instead of encoded bytes; its digest is that of the pixels."""
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
        """(width, height) as fractions of the longer side, the unit of graph positions and keypoints."""
        return extent_of(self.width, self.height)


@dataclass(frozen=True)
class PreparedImage(Image):
    """An image as it is sent to a shared segmentation network: at the scales at which that sees it, not the photo.

    Parameters
    ----------
    scales : tuple of uint8 of shape (height, width, 3)
        The image at each scale, smallest first; `pixels` is the last of them.
    grid : (int, int)
        Rows and columns of the segmentation.
    """

    scales: tuple[Bytes2D, ...] = ()
    grid: tuple[int, int] = (0, 0)


def extent_of(width: int, height: int) -> tuple[float, float]:
    """(width, height) in pixels to fractions of the longer side."""
    longer = max(width, height)
    return width / longer, height / longer


@dataclass(frozen=True)
class ImageFacts:
    """The stored facts of an image: size in pixels and bytes, format, SHA-256 (hex)."""

    width: int
    height: int
    byte_count: int
    format: str
    sha256: str = field(repr=False)
