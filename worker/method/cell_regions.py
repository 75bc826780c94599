"""Regions of an image's grid of cells: where they lie in the image, and values smoothed over neighbouring cells."""

from typing import Literal

import numpy as np

from schemas.description import Booleans, Doubles

Point = tuple[float, float]


def bounding_box(cells: Booleans, extent: Point) -> tuple[Point, Point]:
    """Where the bounding box of some cells of an image lies.

    Parameters
    ----------
    cells : bool of shape (rows, columns)
        At least one is True.
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.

    Returns
    -------
    centre : (float, float)
        (x, y), in fractions of the image's longer side.
    extent : (float, float)
        (width, height), in the same unit.
    """
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    height, width = extent[1] / cells.shape[0], extent[0] / cells.shape[1]
    left, right = float(columns[0]) * width, float(columns[-1] + 1) * width
    top, bottom = float(rows[0]) * height, float(rows[-1] + 1) * height
    return ((left + right) / 2, (top + bottom) / 2), (right - left, bottom - top)


def smoothed(values: Doubles, beyond: Literal["constant", "edge"]) -> Doubles:
    """Means over 3 x 3 cells, float64 (rows, columns) as `values`.

    Beyond the border the values are 0 (``beyond="constant"``) or those of the nearest cell (``"edge"``).
    """
    rows, columns = values.shape
    padded = np.pad(values, 1, mode=beyond)
    total: Doubles = np.sum([padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3)], axis=0)
    return total / 9
