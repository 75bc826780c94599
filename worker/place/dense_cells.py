"""Dense cells: a coarse grid of embeddings, compared cell by cell under small shifts."""

import numpy as np

from schemas.description import Floats, Int8s

SCALE = 127
"""A stored cell is a unit vector times this, rounded."""

MOST_ROWS, MOST_COLUMNS = 2, 4
"""Largest shift in each direction, in cells of the usual 9 x 15 grid."""


def grid(layer: Floats, rows: int, columns: int) -> Floats:
    """Mean embedding of each cell of a coarse grid, less the picture's own mean.

    Without centring, what all cells share (the light, the camera) would decide.

    Parameters
    ----------
    layer : float32 of shape (h, w, channels)
    rows, columns : int
        A grid finer than the layer repeats its cells.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length; zero where a cell equals the mean.
    """
    down = np.arange(rows) * layer.shape[0] // rows
    across = np.arange(columns) * layer.shape[1] // columns
    sums = np.add.reduceat(np.add.reduceat(layer, down, axis=0), across, axis=1)
    cells = _unit(sums)
    return _unit(cells - cells.mean(axis=(0, 1)))


def reduce(cells: Floats, projection: Floats) -> Int8s:
    """Shorten cells for storage.

    Parameters
    ----------
    cells : float32 of shape (rows, columns, channels)
    projection : float32 of shape (channels, dimensions)

    Returns
    -------
    int8 of shape (rows, columns, dimensions)
    """
    return np.rint(_unit(cells @ projection) * SCALE).astype(np.int8)


def similarity(query: Int8s, candidates: Int8s) -> tuple[Floats, "np.ndarray[tuple[int, int], np.dtype[np.int64]]"]:
    """Best mean cosine over small shifts of the whole grid.

    Parameters
    ----------
    query : int8 of shape (rows, columns, dimensions)
    candidates : int8 of shape (n, rows, columns, dimensions)

    Returns
    -------
    scores : float32 of shape (n,)
        -1..1; over the cells where the shifted grids overlap.
    shifts : int64 of shape (n, 2)
        (rows, columns) by which the candidate's grid moved to fit best.
    """
    rows, columns, dimensions = query.shape
    count = len(candidates)
    # One product of all cells with all cells; every shift then only sums entries of it.
    left = query.reshape(-1, dimensions).astype(np.float32) / SCALE
    right = candidates.reshape(-1, dimensions).astype(np.float32) / SCALE
    product = (left @ right.T).reshape(rows, columns, count, rows, columns)
    best = np.full(count, -np.inf, np.float32)
    shifts = np.zeros((count, 2), np.int64)
    for dy in range(-min(MOST_ROWS, rows - 1), min(MOST_ROWS, rows - 1) + 1):
        y = np.arange(max(0, dy), rows + min(0, dy))
        for dx in range(-min(MOST_COLUMNS, columns - 1), min(MOST_COLUMNS, columns - 1) + 1):
            x = np.arange(max(0, dx), columns + min(0, dx))
            mean = product[y[:, None], x[None, :], :, (y - dy)[:, None], (x - dx)[None, :]].mean(axis=(0, 1))
            better = mean > best
            best[better] = mean[better]
            shifts[better] = (dy, dx)
    return best, shifts


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    scaled: Floats = (vectors / np.maximum(lengths, 1e-9)).astype(np.float32)
    return scaled
