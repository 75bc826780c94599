"""What is fixed to the camera: a bonnet, a gripper, black bars, a time stamp.

Such cells and keypoints are the same in every view of a map, wherever it was taken. They agree perfectly with every
place, so they say nothing of any, and hide what does. They are found by looking at views of many places at once, and
left out of a query where it shows them too.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from schemas.description import Booleans, Description, Floats, Indices, Int8s, LocalFeatures
from worker.method.byte_vectors import quantise
from worker.method.dense_cells import halve
from worker.method.unit_length import unit

LEAST_VIEWS = 12
"""Fewer views than this share cells by chance."""

SAME, PARTLY_SAME = 0.7, 0.4
"""Mean cosine, over pairs of views, from which a cell is fixed, and from which it is if it holds a fixed keypoint too:
what a camera carries along has .88 to .98, cells at its edge .6 to .9, those under letters from .4 on. Of six
development sets no other cell has more than .56."""

UNLIKE = 0.4
"""Largest median of that mean over the other cells: else the views themselves look alike, as in a corridor, and nobody
can tell what belongs to the camera."""

MOST = 0.6
"""Share of the cells beyond which nothing would be left to recognise."""

SHOWN = 0.6
"""Least cosine of a query's cell with what is fixed there, for it to show the same: cameras carry different things."""

OFTEN = 0.4
"""Share of the views in which a keypoint must lie, to be fixed: each image keeps some hundred of all that it has."""

NEAR, LIKE = 0.008, 0.85
"""How near in the image, in fractions of its longer side, and how like by their cosine two keypoints are the same."""

SOUGHT_IN = 8
"""Views of which each keypoint is sought in the others: what lies in two fifths of all lies in one of these."""

SPOTS = 128
"""Squares along the longer side in which keypoints are counted, before they are compared."""


@dataclass(frozen=True, eq=False)
class CameraFixed:
    """What is fixed to the camera that took the views of a map.

    Parameters
    ----------
    looks : float32 of shape (rows, columns, dimensions)
        Mean embedding of each cell that may be fixed, unit length; zero for all others.
    sure : bool of shape (rows, columns)
        Cells that are fixed whatever keypoints they hold.
    keypoints : LocalFeatures
        Those that are fixed.
    """

    looks: Floats
    sure: Booleans
    keypoints: LocalFeatures

    def cells_shown(self, query: Description) -> Booleans:
        """Which cells of a query show what is fixed there, of shape (rows, columns)."""
        if query.cells.shape != self.looks.shape:
            return np.zeros(query.cells.shape[:2], np.bool_)
        fixed = self.sure.copy()
        if query.keypoints is not None:
            on = query.keypoints.positions[self.keypoints_shown(query.keypoints)]
            fixed[_cells_at(on, query.appearance.extent, fixed.shape)] = True
        cosines = np.einsum("rcd,rcd->rc", unit(query.cells.astype(np.float32)), self.looks)
        return np.asarray(fixed & (cosines >= SHOWN))

    def cleared(self, cells: Int8s) -> Int8s:
        """The cells of a view, at full or half resolution, without those that surely show what is fixed there."""
        sure, looks = (self.sure, self.looks) if cells.shape[0] == self.sure.shape[0] else self._halved
        if cells.shape != looks.shape:
            return cells
        shown = np.einsum("nd,nd->n", unit(cells[sure].astype(np.float32)), looks[sure]) >= SHOWN
        left: Int8s = cells.copy()
        left[sure] = np.where(shown[:, None], np.int8(0), left[sure])
        return left

    @cached_property
    def _halved(self) -> tuple[Booleans, Floats]:
        """`sure` and `looks` at half resolution; sure is what four sure cells make."""
        rows, columns = (side // 2 for side in self.sure.shape)
        fours = self.sure[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)
        return np.asarray(fours.all(axis=(1, 3))), halve(self.looks)

    def keypoints_shown(self, keypoints: LocalFeatures) -> Booleans:
        """Which keypoints of a query are fixed ones, of shape (keypoints,)."""
        if keypoints.descriptors.shape[1:] != self.keypoints.descriptors.shape[1:]:
            return np.zeros(len(keypoints), np.bool_)
        return np.asarray(_same(keypoints, self.keypoints).any(axis=1))


def camera_fixed(cells: Int8s, keypoints: Sequence[LocalFeatures] = ()) -> CameraFixed | None:
    """What is fixed to the camera, by views of different places; None when nothing is, or it cannot be told.

    Parameters
    ----------
    cells : int8 of shape (views, rows, columns, dimensions)
        Dense cells of views drawn from a whole map.
    keypoints : sequence of LocalFeatures
        Of the same views; none where the recipe has none.

    Notes
    -----
    With unit vectors u_i of a cell in n views the mean cosine over pairs is (|sum u_i|^2 - n) / (n (n - 1)).
    """
    views = len(cells)
    if views < LEAST_VIEWS or cells.size == 0:
        return None
    total = unit(cells.astype(np.float32)).sum(axis=0)
    similarity = (np.square(total).sum(axis=-1) - views) / (views * (views - 1))
    sure = similarity >= SAME
    if sure.mean() > MOST or np.median(similarity[~sure]) > UNLIKE:
        return None
    fixed = _often(keypoints)
    if not sure.any() and not len(fixed):
        return None
    looks = unit(np.where((similarity >= PARTLY_SAME)[..., None], total, np.float32(0)))
    return CameraFixed(looks, sure, fixed)


def without_fixed(query: Description, fixed: Iterable[CameraFixed | None]) -> Description:
    """The query without cells and keypoints that show what is fixed to a camera.

    Parameters
    ----------
    query : Description
    fixed : iterable of CameraFixed or None
        Of each map that is searched.

    Notes
    -----
    Histograms stay as they are: those of the map's views count the same things too.
    """
    keypoints = query.keypoints
    cells = np.zeros(query.cells.shape[:2], np.bool_)
    points = np.zeros(0 if keypoints is None else len(keypoints), np.bool_)
    for one in fixed:
        if one is not None:
            cells |= one.cells_shown(query)
            points |= np.False_ if keypoints is None else one.keypoints_shown(keypoints)
    if not cells.any() and not points.any():
        return query
    if keypoints is not None:
        kept = ~(points | cells[_cells_at(keypoints.positions, query.appearance.extent, cells.shape)])
        keypoints = LocalFeatures(keypoints.positions[kept], keypoints.descriptors[kept])
    left = np.where(cells[..., None], np.int8(0), query.cells)
    appearance = replace(query.appearance, coarse=quantise(halve(left)))
    return replace(query, cells=left, appearance=appearance, keypoints=keypoints)


def left_out(query: Description, shown: Description) -> Booleans:
    """Cells of a query that `without_fixed` left out, of shape (rows, columns)."""
    return np.asarray(query.cells.any(axis=-1) & ~shown.cells.any(axis=-1))


def share_left_out(query: Description, shown: Description) -> float:
    """Share of a query's cells that `without_fixed` left out, 0..1."""
    return float(left_out(query, shown).mean()) if query.cells.size else 0.0


def _often(keypoints: Sequence[LocalFeatures]) -> LocalFeatures:
    """Keypoints that lie in the same spot of many views and look the same; each of them once."""
    if not keypoints:
        return LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 0), np.int8))
    view = np.repeat(np.arange(len(keypoints)), [len(one) for one in keypoints])
    everything = LocalFeatures(
        np.concatenate([one.positions for one in keypoints]), np.concatenate([one.descriptors for one in keypoints])
    )
    # By squares first, twice as many as are wanted: a keypoint at an edge falls into two by turns.
    column, row = np.floor(everything.positions * SPOTS).astype(np.int64).T
    square = column * SPOTS + row
    inhabited = np.unique(square * len(keypoints) + view) // len(keypoints)
    squares, views = np.unique(inhabited, return_counts=True)
    there = np.flatnonzero(np.isin(square, squares[views >= OFTEN / 2 * len(keypoints)]))
    few = there[view[there] < SOUGHT_IN]
    sought = LocalFeatures(everything.positions[few], everything.descriptors[few])
    seen_in = np.zeros(len(few), np.intp)
    for each in range(len(keypoints)):  # one view at a time: of all at once the cosines take 100 MB
        own = there[view[there] == each]
        candidates = LocalFeatures(everything.positions[own], everything.descriptors[own])
        seen_in += _same(sought, candidates).any(axis=1)
    often = np.flatnonzero(seen_in >= OFTEN * len(keypoints))
    found = LocalFeatures(sought.positions[often], sought.descriptors[often])
    same = _same(found, found)
    once = [i for i in range(len(found)) if not same[i, :i].any()]
    return LocalFeatures(found.positions[once], found.descriptors[once])


def _same(one: LocalFeatures, other: LocalFeatures) -> Booleans:
    """Which keypoints are the same, of shape (keypoints of one, keypoints of the other)."""
    (x, y), (others_x, others_y) = one.positions.T, other.positions.T
    near = (np.abs(x[:, None] - others_x) <= NEAR) & (np.abs(y[:, None] - others_y) <= NEAR)
    cosines = unit(one.descriptors.astype(np.float32)) @ unit(other.descriptors.astype(np.float32)).T
    same: Booleans = near & (cosines >= LIKE)
    return same


def _cells_at(positions: Floats, extent: tuple[float, float], shape: tuple[int, ...]) -> tuple[Indices, Indices]:
    """Row and column of the cell at each position, in fractions of the image's longer side."""
    rows, columns = shape
    row = np.clip((positions[:, 1] / extent[1] * rows).astype(np.intp), 0, rows - 1)
    column = np.clip((positions[:, 0] / extent[0] * columns).astype(np.intp), 0, columns - 1)
    return row, column
