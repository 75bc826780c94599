"""The tiny image: 32 x 32 grey, each patch brought to the same brightness and contrast (as SeqSLAM does)."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from lab.baselines.baseline import Tick, city_block, described, grey
from schemas.description import Floats

SIDE, PATCH = 32, 8


class TinyImage:
    """City-block distance between patch-normalised thumbnails."""

    name = "tiny image"

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""
        return city_block(described(database, thumbnail, tick), described(queries, thumbnail, tick))


def thumbnail(path: Path) -> Floats:
    """An image as float32 (1024,): each 8 x 8 patch with mean 0 and deviation 1 (in grey levels, plus one)."""
    return normalised(cv2.resize(grey(path), (SIDE, SIDE), interpolation=cv2.INTER_AREA))


def normalised(image: npt.NDArray[np.uint8]) -> Floats:
    """A small grey image, height and width multiples of 8, as a vector of patches brought to the same contrast."""
    height, width = image.shape
    patches = image.astype(np.float32).reshape(height // PATCH, PATCH, width // PATCH, PATCH)
    # One grey level is added to the deviation, or the noise of an even patch of sky would count as much as a facade.
    normal = (patches - patches.mean((1, 3), keepdims=True)) / (patches.std((1, 3), keepdims=True) + 1)
    return np.asarray(normal.reshape(-1), np.float32)
