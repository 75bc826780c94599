"""An ensemble of segmentation networks, for segmentations that are shown to people.

Each member sees the image at two sizes, once mirrored (test-time augmentation). The mean over all is finer and more
accurate than the layer ``semantic`` of descriptions; it is never stored.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.image import Bytes2D, Image, PreparedImage
from worker.encoders.compact.engine import Engine
from worker.encoders.compact.input_size import LONGEST, network_size, resized
from worker.method.unit_length import unit

SEGMENTATION_STRIDE = 4
"""Pixels per cell of a segmentation, along each side."""

ENSEMBLE = ("fine", "second", "third")
"""Names of the members in the JSON file, each with weights and a graph; the last ones may be missing."""


@dataclass(frozen=True)
class Augmentation:
    """How a member of the ensemble sees an image.

    Parameters
    ----------
    member : int
        Index into `ENSEMBLE`.
    scale : float
        Longer side of its input, relative to `LONGEST`.
    mirrored : bool
        Whether it sees the mirror image.
    weight : float
        Its weight in the mean, before confidence.
    """

    member: int
    scale: float
    mirrored: bool
    weight: float = 1.0


AUGMENTATIONS = (
    *(Augmentation(0, 0.75, True), Augmentation(0, 1.25, False)),
    *(Augmentation(1, 1.25, False, 1.4), Augmentation(1, 1.5, True, 1.4)),
    *(Augmentation(2, 1.25, False, 1.4), Augmentation(2, 1.5, True, 1.4)),
)
"""Inputs of all members; the weighted mean of the outputs is the segmentation."""

CONFIDENCE_POWER = 6
"""Exponent of the label confidence in an output's weight: the later members are better on streets than on rooms."""


def digest_of(weights: Sequence[str]) -> str:
    """SHA-256 (hex) of all that decides a segmentation: digests of the encoder's and the members' weights, and how they
    are used. Two processes with the same one draw the same."""
    used = (*weights, AUGMENTATIONS, CONFIDENCE_POWER, LONGEST, SEGMENTATION_STRIDE)
    return hashlib.sha256(repr(used).encode()).hexdigest()


class CompactSegmenter:
    """Segments an image with the members of the ensemble whose weights are there.

    Parameters
    ----------
    engine : Engine
    vectors : float32 of shape (labels, channels)
        Text vectors of all known labels.
    members : int
        Number of members, at least 1.
    digest : str
        `digest_of` its weights.
    """

    def __init__(self, engine: Engine, vectors: Floats, members: int, digest: str) -> None:
        self._engine, self._vectors, self._members = engine, vectors, members
        self.digest = digest

    @property
    def scales(self) -> int:
        """Number of scales at which it sees an image."""
        return len(scales_of(self._members))

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        """The layer ``semantic`` only, one cell per 4 x 4 pixels; see `Segmenter.segment`."""
        ready = image if isinstance(image, PreparedImage) else prepared(image, self._members)

        def one(pixels: Bytes2D, member: int) -> Floats:
            layer: Floats = self._engine.segment(pixels[None], member)[0]
            return layer

        return PixelField({SEMANTIC: segment_with_ensemble(ready, one, self._vectors, self._members)}, image.extent)


def scales_of(members: int) -> list[float]:
    """The scales at which so many members see an image, smallest first."""
    return sorted({how.scale for how in AUGMENTATIONS if how.member < members})


def prepared(image: Image, members: int, longest: float = LONGEST) -> PreparedImage:
    """An image at the scales at which so many members see it; these are relative to `longest`, in pixels."""
    columns, rows = (side // SEGMENTATION_STRIDE for side in network_size(image.width, image.height, longest))
    scales = tuple(resized(image.pixels, scale * longest) for scale in scales_of(members))
    return PreparedImage(scales[-1], image.digest, image.format, image.byte_count, scales, (rows, columns))


def segment_with_ensemble(
    image: PreparedImage, segment: Callable[[Bytes2D, int], Floats], vectors: Floats, members: int
) -> Floats:
    """Weighted mean of the semantic layers over `AUGMENTATIONS`.

    Parameters
    ----------
    image : PreparedImage
        As from `prepared`, for as many members.
    segment : function
        Maps pixels, as from `resized`, and a member's index to float32 of shape (height / 4, width / 4, channels).
    vectors : float32 of shape (labels, channels)
        Text vectors of all known labels.
    members : int
        Number of members, at least 1.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length, on the grid of the image.
    """
    down, across = image.grid
    at = dict(zip(scales_of(members), image.scales, strict=True))
    total = np.zeros(())
    for how in AUGMENTATIONS:
        if how.member >= members:
            continue
        seen = at[how.scale]
        layer = segment(np.ascontiguousarray(seen[:, ::-1]) if how.mirrored else seen, how.member)
        layer = cv2.resize(layer, (across, down), interpolation=cv2.INTER_LINEAR)
        count = how.weight * label_confidence(layer, vectors) ** CONFIDENCE_POWER
        total = total + count * (layer[:, ::-1] if how.mirrored else layer)
    return unit(total)


def label_confidence(layer: Floats, vectors: Floats) -> float:
    """Mean over cells of the largest cosine with any label, at least 0.01.

    Parameters
    ----------
    layer : float32 of shape (rows, columns, channels)
    vectors : float32 of shape (labels, channels)
    """
    nearest = (layer.reshape(-1, layer.shape[2]) @ vectors.T).max(axis=1)
    return max(float(nearest.mean()), 0.01)
