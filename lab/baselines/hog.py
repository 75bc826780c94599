"""Histograms of oriented gradients of the whole image (Dalal and Triggs, CVPR 2005).

Written out, since OpenCV 5 no longer has ``cv2.HOGDescriptor``.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from lab.baselines.baseline import Tick, city_block, described, grey
from schemas.description import Floats

SIDE, CELL, BINS = 256, 16, 9
CELLS = SIDE // CELL
CLIP = 0.2


class Hog:
    """City-block distance between gradient histograms."""

    name = "hog"

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""

        def describe(path: Path) -> Floats:
            return gradients(cv2.resize(grey(path), (SIDE, SIDE), interpolation=cv2.INTER_AREA))

        return city_block(described(database, describe, tick), described(queries, describe, tick))


def gradients(image: npt.NDArray[np.uint8]) -> Floats:
    """The descriptor of a 256 x 256 grey image, float32 (8100,).

    Notes
    -----
    16 x 16 cells of 16 x 16 pixels; 9 unsigned orientations, each gradient shared between the two nearest; blocks
    of 2 x 2 cells, one cell apart; each block L2-Hys normalised.
    """
    g = np.pad(image.astype(np.float32), 1, mode="reflect")
    dx, dy = g[1:-1, 2:] - g[1:-1, :-2], g[2:, 1:-1] - g[:-2, 1:-1]
    size = np.hypot(dx, dy)
    # In units of bins; the middle of bin 0 is half a bin above the angle 0.
    angle = np.mod(np.arctan2(dy, dx), np.pi) / np.pi * BINS - 0.5
    low = np.floor(angle)
    share = angle - low
    rows, columns = np.indices((SIDE, SIDE)) // CELL
    first = (rows * CELLS + columns) * BINS
    cells = np.zeros(CELLS * CELLS * BINS)
    for bins, weight in ((low % BINS, 1 - share), ((low + 1) % BINS, share)):
        where = (first + bins.astype(np.int64)).ravel()
        cells += np.bincount(where, weights=(size * weight).ravel(), minlength=len(cells))
    grid = cells.reshape(CELLS, CELLS, BINS)
    blocks = np.concatenate([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]], axis=2)
    blocks = np.minimum(_unit(blocks), CLIP)
    return _unit(blocks).astype(np.float32).ravel()


def _unit(blocks: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Blocks at length 1; the small constant keeps an empty one empty."""
    return np.asarray(blocks / (np.linalg.norm(blocks, axis=2, keepdims=True) + 1e-3))
