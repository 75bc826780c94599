"""What is fixed to the camera: a bonnet, a gripper, black bars, a time stamp.

Such cells are the same in every view of a map, wherever it was taken. They agree perfectly with every place, so they
say nothing of any, and hide what does. They are found by looking at views of many places at once, and left out of a
query where it shows them too.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from schemas.description import Booleans, Description, Floats, Int8s, LocalFeatures
from worker.method.byte_vectors import quantise
from worker.method.dense_cells import halve
from worker.method.unit_length import unit

LEAST_VIEWS = 12
"""Fewer views than this share cells by chance."""

SAME = 0.7
"""Mean cosine, over pairs of views, from which a cell is fixed: what a camera carries along has .88 to .98, cells at
its edge .6 to .9; of six development sets no other cell has more than .56."""

UNLIKE = 0.4
"""Largest median of that mean over the other cells: else the views themselves look alike, as in a corridor, and nobody
can tell what belongs to the camera."""

MOST = 0.6
"""Share of the cells beyond which nothing would be left to recognise."""

SHOWN = 0.6
"""Least cosine of a query's cell with what is fixed there, for it to show the same: cameras carry different things."""


@dataclass(frozen=True, eq=False)
class CameraFixed:
    """What is fixed to the camera that took the views of a map.

    Parameters
    ----------
    looks : float32 of shape (rows, columns, dimensions)
        Mean embedding of each fixed cell, unit length; zero for cells that are not fixed.
    """

    looks: Floats

    @property
    def cells(self) -> Booleans:
        """True where a cell is fixed; of shape (rows, columns)."""
        return np.asarray(self.looks.any(axis=-1))

    def shown(self, cells: Int8s) -> Booleans:
        """Which cells of an image show what is fixed there, of shape (rows, columns)."""
        if cells.shape != self.looks.shape:
            return np.zeros(cells.shape[:2], np.bool_)
        cosines = np.einsum("rcd,rcd->rc", unit(cells.astype(np.float32)), self.looks)
        shown: Booleans = self.cells & (cosines >= SHOWN)
        return shown


def camera_fixed(cells: Int8s) -> CameraFixed | None:
    """What is fixed to the camera, by views of different places; None when nothing is, or it cannot be told.

    Parameters
    ----------
    cells : int8 of shape (views, rows, columns, dimensions)
        Dense cells of views drawn from a whole map.

    Notes
    -----
    With unit vectors u_i of a cell in n views the mean cosine over pairs is (|sum u_i|^2 - n) / (n (n - 1)).
    """
    views = len(cells)
    if views < LEAST_VIEWS or cells.size == 0:
        return None
    total = unit(cells.astype(np.float32)).sum(axis=0)
    similarity = (np.square(total).sum(axis=-1) - views) / (views * (views - 1))
    fixed = similarity >= SAME
    if not fixed.any() or fixed.mean() > MOST or np.median(similarity[~fixed]) > UNLIKE:
        return None
    return CameraFixed(unit(np.where(fixed[..., None], total, np.float32(0))))


def without_fixed(query: Description, fixed: Iterable[CameraFixed | None]) -> Description:
    """The query without cells, and keypoints on them, that show what is fixed to a camera.

    Parameters
    ----------
    query : Description
    fixed : iterable of CameraFixed or None
        Of each map that is searched.

    Notes
    -----
    Histograms stay as they are: those of the map's views count the same things too.
    """
    left_out = np.zeros(query.cells.shape[:2], np.bool_)
    for one in fixed:
        if one is not None:
            left_out |= one.shown(query.cells)
    if not left_out.any():
        return query
    cells = np.where(left_out[..., None], np.int8(0), query.cells)
    appearance = replace(query.appearance, coarse=quantise(halve(cells)))
    keypoints = query.keypoints
    if keypoints is not None:
        kept = ~_at(left_out, keypoints.positions, query.appearance.extent)
        keypoints = LocalFeatures(keypoints.positions[kept], keypoints.descriptors[kept])
    return replace(query, cells=cells, appearance=appearance, keypoints=keypoints)


def share_left_out(query: Description, shown: Description) -> float:
    """Share of a query's cells that `without_fixed` left out, 0..1."""
    if not query.cells.size:
        return 0.0
    return float((query.cells.any(axis=-1) & ~shown.cells.any(axis=-1)).mean())


def _at(mask: Booleans, positions: Floats, extent: tuple[float, float]) -> Booleans:
    """Values of a mask over the image at positions, in fractions of its longer side."""
    rows, columns = mask.shape
    column = np.clip((positions[:, 0] / extent[0] * columns).astype(np.intp), 0, columns - 1)
    row = np.clip((positions[:, 1] / extent[1] * rows).astype(np.intp), 0, rows - 1)
    found: Booleans = mask[row, column]
    return found
