"""Which cells of a photo have no counterpart in another photo of the place: they are *lost*.

An affine transform says where each cell of one photo lies in the other. It is exact for one depth alone, so a cell is
looked for around there; a cell that nothing around there looks like is lost.

Light and season alter all cells: similarity is measured between two levels that the pair itself has, that of cells at
corresponding positions and that of any.
"""

from dataclasses import dataclass

import numpy as np

from schemas.description import Booleans, Doubles, Floats, Indices
from worker.method.cell_regions import Point, smoothed
from worker.method.labels import label_map

REACH = 0.05
"""How far around its expected position a cell is looked for, as a fraction of the longer side: room for parallax."""

LOST = 0.65
"""A cell is lost below this similarity, where 1 is usual at corresponding positions and 0 at any."""

LARGEST_SHORTAGE = 0.5
"""A cell's shortage of its label is counted up to this."""


@dataclass(frozen=True, eq=False)
class PhotoCells:
    """A photo as cells.

    Parameters
    ----------
    cells : float32 of shape (rows, columns, channels)
        Embeddings, unit length.
    scores : float32 of shape (rows, columns, labels)
        Cosines of the cells with the labels.
    static : bool of shape (rows, columns)
        False for cells of things that move by themselves: they are not compared.
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.
    """

    cells: Floats
    scores: Floats
    static: Booleans
    extent: Point

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.static.shape
        return rows, columns


@dataclass(frozen=True, eq=False)
class Compared:
    """One photo against another.

    Parameters
    ----------
    comparable : bool of shape (rows, columns)
        Cells that lie within the other photo, and are static in both.
    similarity : float64 of shape (rows, columns)
        Of each cell and the likest around its expected position: 1 is usual there, 0 at any position.
    shortage : float64 of shape (rows, columns)
        By how much the cell's label falls behind the best one around its expected position: the least of them.
    expected : (int of shape (rows, columns), int of shape (rows, columns))
        Row and column in the other photo; of cells beyond it those of the nearest cell.
    usual : float
        Median cosine at corresponding positions.
    """

    comparable: Booleans
    similarity: Doubles
    shortage: Doubles
    expected: tuple[Indices, Indices]
    usual: float

    @property
    def lost(self) -> Booleans:
        """The cells that are lost, of shape (rows, columns)."""
        return self.comparable & (smoothed(self.similarity, "edge") < LOST)


def compare(here: PhotoCells, there: PhotoCells, transform: Doubles) -> Compared:
    """Look for each cell of one photo in the other, around where it is expected.

    Parameters
    ----------
    here, there : PhotoCells
        By one encoder and one list of labels.
    transform : float64 of shape (2, 3)
        Affine: positions (x, y, 1) in `here` to those in `there`, fractions of the longer side.
    """
    rows, columns = there.shape
    row, column = _expected(here, there, transform)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    nearest = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    comparable = inside & here.static & there.static[nearest]
    likest, shortage = _looked_for(here, there, row, column)
    usual = float(np.median(likest[comparable])) if comparable.any() else 0.0
    ours, theirs = (photo.cells.reshape(-1, photo.cells.shape[-1])[::7] for photo in (here, there))
    chance = float(np.median(ours @ theirs.T))
    return Compared(comparable, (likest - chance) / max(usual - chance, 1e-6), shortage, nearest, usual)


def _expected(here: PhotoCells, there: PhotoCells, transform: Doubles) -> tuple[Indices, Indices]:
    """Row and column of each cell of one photo in the other, which may lie beyond it."""
    rows, columns = there.shape
    x, y = (np.arange(n) + 0.5 for n in here.shape[::-1])
    across, down = np.meshgrid(x / here.shape[1] * here.extent[0], y / here.shape[0] * here.extent[1])
    expected = np.stack([across, down], axis=-1) @ transform[:, :2].T + transform[:, 2]
    row = np.rint(expected[..., 1] / there.extent[1] * rows - 0.5).astype(np.intp)
    column = np.rint(expected[..., 0] / there.extent[0] * columns - 0.5).astype(np.intp)
    return row, column


def _looked_for(here: PhotoCells, there: PhotoCells, row: Indices, column: Indices) -> tuple[Doubles, Doubles]:
    """For each cell, the largest cosine within reach of its expected position, and the least shortage of its label."""
    rows, columns = there.shape
    labels, best = label_map(here.scores), there.scores.max(axis=-1)
    likest, shortage = np.full(here.shape, -1.0), np.full(here.shape, LARGEST_SHORTAGE)
    reach_down, reach_across = round(REACH / there.extent[1] * rows), round(REACH / there.extent[0] * columns)
    for dy in range(-reach_down, reach_down + 1):
        for dx in range(-reach_across, reach_across + 1):
            r, c = row + dy, column + dx
            within = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            r, c = np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)
            cosine = np.einsum("rcd,rcd->rc", here.cells, there.cells[r, c])
            likest = np.where(within, np.maximum(likest, cosine), likest)
            short = best[r, c] - there.scores[r, c, labels]
            shortage = np.where(within, np.minimum(shortage, short), shortage)
    return likest, shortage
