"""An encoder without weights that takes colours for labels, for tests and for trying out the service."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np

from schemas.description import DETAIL, SEMANTIC, Floats, PixelField
from schemas.errors import InvalidParameters, ParameterError
from schemas.image import Image
from schemas.records import Meaning
from worker.method.unit_length import unit

COLORS: Mapping[str, tuple[int, int, int]] = {
    "road": (90, 90, 95),
    "sidewalk": (170, 165, 160),
    "building": (165, 95, 70),
    "vehicle": (200, 30, 30),
    "car": (220, 20, 60),
    "bicycle": (230, 120, 200),
    "motorcycle": (150, 20, 120),
    "vegetation": (60, 130, 50),
    "trunk": (95, 65, 40),
    "terrain": (140, 165, 80),
    "cyclist": (250, 90, 140),
    "pole": (50, 50, 55),
    "sky": (140, 185, 235),
    "other": (240, 230, 60),
}
"""RGB colour of each of the paper's labels."""

CELL = 8
"""Pixels per cell, at a longer side of LONGEST."""

LONGEST = 480


class ColorEncoder:
    """Embeds a cell by its mean colour and its contrast to its neighbours.

    The layer ``semantic`` is the colour as a unit vector of eight numbers; ``detail`` adds local gradients. The text
    vector of a label is that of its colour.
    """

    name = "color"
    terms = "none but those of the code (Apache-2.0): it has no weights"

    def __init__(self) -> None:
        self.digest = hashlib.sha256(repr((sorted(COLORS.items()), CELL, LONGEST)).encode()).hexdigest()
        self.layers: Mapping[str, int] = {SEMANTIC: 8, DETAIL: 12}
        self.known_labels: frozenset[str] | None = frozenset(COLORS)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image; see `Encoder.encode`."""
        return (self._encode(image) for image in images)

    def _encode(self, image: Image) -> PixelField:
        width, height = image.extent
        columns, rows = (max(4, round(side * LONGEST / CELL)) for side in (width, height))
        mean = cv2.resize(image.pixels, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(
            255
        )
        semantic = unit(_spread(mean))
        across = np.gradient(mean, axis=1)
        down = np.gradient(mean, axis=0)
        detail = unit(np.concatenate([_spread(mean) * 0.5, across.mean(-1, keepdims=True) * 4,
                                       down.mean(-1, keepdims=True) * 4, np.abs(across).mean(-1, keepdims=True) * 4,
                                       np.abs(down).mean(-1, keepdims=True) * 4], axis=-1))  # fmt: skip
        return PixelField({SEMANTIC: semantic, DETAIL: detail}, image.extent)

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        """See `Encoder.text_vectors`."""
        self.meanings(labels)
        colours = np.array([COLORS[label] for label in labels], np.float32).reshape(-1, 3) / np.float32(255)
        return unit(_spread(colours))

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        """See `Encoder.meanings`."""
        unknown = [label for label in labels if label not in COLORS]
        if unknown:
            known = ", ".join(COLORS)
            raise InvalidParameters([ParameterError("labels", f"{w!r} is not known; known: {known}") for w in unknown])
        return [Meaning(label, (label,), trained=True) for label in labels]


def _spread(colours: Floats) -> Floats:
    """Colours (..., 3) in 0..1 as eight smooth numbers whose directions differ where the colours do."""
    centred = (colours - 0.5) * 2
    red, green, blue = np.moveaxis(centred, -1, 0)
    spread: Floats = np.stack(
        [red, green, blue, red - green, green - blue, blue - red, red * green * blue, np.full_like(red, 0.3)], axis=-1
    )
    return spread
