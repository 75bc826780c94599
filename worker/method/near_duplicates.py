"""Near-duplicates: views whose descriptions hardly differ, so that all but one add nothing to their map."""

import numpy as np

from schemas.description import Floats, Int8s
from worker.method.camera_fixed import CameraFixed

NEAR, SAME = 0.65, 0.94
"""Histogram distance up to which views may be duplicates, and mean cosine of their cells from which they are. The same
photo, saved again with much loss or at three quarters of the size, has at least .942; the next frame of a walk along a
corridor at most .933 (encoder `compact`)."""

BLOCK = 512
"""Views compared with all others at a time: bounds the memory."""


def alike(vectors: Floats, within: float, most: int) -> list[list[int]]:
    """For each row its nearest later rows, at most `within` away.

    Parameters
    ----------
    vectors : float32 of shape (n, dimensions)
    within : float
        Euclidean distance.
    most : int
        Later rows of each row at most.

    Returns
    -------
    list of list of int
        n lists, nearest first.
    """
    squares = np.einsum("ij,ij->i", vectors, vectors)
    found: list[list[int]] = []
    for start in range(0, len(vectors), BLOCK):
        block = vectors[start : start + BLOCK]
        distances = squares[start : start + BLOCK, None] + squares[start:] - 2 * block @ vectors[start:].T
        near = np.triu(distances <= within**2, 1)
        for row, away in zip(near, distances, strict=True):
            hits = np.flatnonzero(row)
            found.append((hits[np.argsort(away[hits], kind="stable")[:most]] + start).tolist())
    return found


def similarity(one: Int8s, other: Int8s, fixed: CameraFixed | None = None) -> float:
    """Mean cosine of the dense cells of two views at the same places, -1..1; 0 when their grids differ.

    Cells are int8 of shape (rows, columns, dimensions); those of zeros, which are dynamic in either, do not count, nor
    do those that show what is fixed to the map's camera: they are the same wherever it is.
    """
    if one.shape != other.shape or one.size == 0:
        return 0.0
    if fixed is not None:
        one = fixed.cleared(one)
    a, b = (cells.reshape(-1, cells.shape[-1]).astype(np.float32) for cells in (one, other))
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    static = lengths > 0
    cosines: Floats = (a * b).sum(axis=1)[static] / lengths[static]
    return float(cosines.mean()) if len(cosines) else 0.0
