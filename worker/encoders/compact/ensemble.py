"""An ensemble of segmentation networks, for segmentations that are shown to people.

Each member sees the image at two sizes, once mirrored (test-time augmentation). The mean over all is finer and more
accurate than the layer ``semantic`` of descriptions; it is never stored.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.image import Bytes2D, Image
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


class CompactSegmenter:
    """Segments an image with the members of the ensemble whose weights are there.

    Parameters
    ----------
    engine : Engine
    vectors : float32 of shape (labels, channels)
        Text vectors of all known labels.
    members : int
        Number of members, at least 1.
    """

    def __init__(self, engine: Engine, vectors: Floats, members: int) -> None:
        self._engine, self._vectors, self._members = engine, vectors, members

    def segment(self, image: Image) -> PixelField:
        """The layer ``semantic`` only, one cell per 4 x 4 pixels; see `Segmenter.segment`."""

        def one(pixels: Bytes2D, member: int) -> Floats:
            layer: Floats = self._engine.segment(pixels[None], member)[0]
            return layer

        return PixelField(
            {SEMANTIC: segment_with_ensemble(image.pixels, one, self._vectors, self._members)}, image.extent
        )


def segment_with_ensemble(
    pixels: Bytes2D,
    segment: Callable[[Bytes2D, int], Floats],
    vectors: Floats,
    members: int = len(ENSEMBLE),
    longest: float = LONGEST,
) -> Floats:
    """Weighted mean of the semantic layers over `AUGMENTATIONS`.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    segment : function
        Maps pixels, as from `resized`, and a member's index to float32 of shape (height / 4, width / 4, channels).
    vectors : float32 of shape (labels, channels)
        Text vectors of all known labels.
    members : int
        Number of members, at least 1.
    longest : float
        Longer side, in pixels, that scales are relative to.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length; one cell per 4 x 4 pixels of the image resized to `longest`.
    """
    across, down = (side // SEGMENTATION_STRIDE for side in network_size(pixels.shape[1], pixels.shape[0], longest))
    total = np.zeros(())
    for how in AUGMENTATIONS:
        if how.member >= members:
            continue
        seen = resized(pixels, how.scale * longest)
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
