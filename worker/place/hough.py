"""Hough voting: the displacement and zoom on which corresponding cells of two pictures agree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import Floats

Indices = npt.NDArray[np.intp]
Doubles = npt.NDArray[np.float64]

ZOOMS = (1.0, 0.8, 1.25)
"""How much larger the candidate may show what the query shows; the earlier wins a tie."""

LARGEST_SCALE = 2.0
"""Scales are cut off here, and at its inverse: what few cells tell beyond is noise."""

CERTAINTY = 250.0
"""Weight of the cells that agree, times their squared distance from their centre, at which a scale is believed half."""

TOLERANCE = 2
"""How many cells a correspondence may lie off the common displacement: room for parallax and perspective."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Mutually best cells of a query and of several candidates, one row per pair.

    Rows are ordered by candidate, then by query cell. Cells are numbered row by row.

    Parameters
    ----------
    candidate, query_cell, candidate_cell : intp of shape (pairs,)
    cosine : float32 of shape (pairs,)
        Greater than 0, at most 1.
    """

    candidate: Indices
    query_cell: Indices
    candidate_cell: Indices
    cosine: Floats


@dataclass(frozen=True, eq=False)
class Agreement:
    """How well the cells of several candidates agree with those of a query.

    Parameters
    ----------
    scores : float32 of shape (candidates,)
        Root of the share of what the query's cells could weigh, 0..1; 1 for a picture against itself when no two of
        its cells are equal.
    shifts : intp of shape (candidates, 2)
        (rows, columns) by which the query's centre moves: the mean over the cells that agree, in cells.
    zooms : float32 of shape (candidates,)
        The zoom that fits best; 1 where nothing corresponds.
    scales : float32 of shape (candidates,)
        How much larger the candidate shows what the query shows, by the cells that agree, 0.5..2: as `zooms`, but of
        any size, and the nearer to 1 the less the cells can tell.
    """

    scores: Floats
    shifts: Indices
    zooms: Floats
    scales: Floats


def agreement(
    pairs: Correspondences,
    distinct: Floats,
    shape: tuple[int, int],
    candidates: int,
    zooms: Sequence[float] = ZOOMS,
    tolerance: int = TOLERANCE,
    *,
    measured: bool = True,
) -> Agreement:
    """The largest weight of correspondences that agree on one displacement (a Hough transform).

    Parameters
    ----------
    pairs : Correspondences
    distinct : float32 of shape (rows * columns,)
        What each of the query's cells counts for, at least 0.
    shape : (int, int)
        Rows and columns of the grids.
    candidates : int
        How many candidates there are, those without a correspondence included.
    zooms : sequence of float
        Greater than 0.
    tolerance : int
        In cells, at least 0.
    measured : bool
        Whether scales are asked for; without, they are all 1.

    Returns
    -------
    Agreement

    Notes
    -----
    A correspondence of cosine c weighs c^2 times the distinctness of its cell: one that fits half counts a quarter.
    Displacements of more than half the picture are left out: too little of it would be common. With zoom z a query
    cell p (from the picture's centre) belongs at z p + t; both sides are divided by sqrt(z) so
    that the tolerance is the same in either direction. The root brings channels together whose shares differ in size:
    without it the one with larger shares decides alone.
    """
    weight = pairs.cosine.astype(np.float64) ** 2 * distinct[pairs.query_cell]
    roots = np.sqrt(np.array(zooms, np.float64))[:, None]
    ours, theirs = (np.stack(_centred(cell, shape)) for cell in (pairs.query_cell, pairs.candidate_cell))
    displacement = [theirs[axis] / roots - ours[axis] * roots for axis in (0, 1)]
    bins = [np.rint(along).astype(np.intp) for along in displacement]
    heights, peaks = _peaks(pairs.candidate, bins, weight, candidates, shape, tolerance)
    score, chosen = np.zeros(candidates), np.zeros(candidates, np.intp)
    for zoom, height in enumerate(heights):
        better = height > score + 1e-9
        score[better], chosen[better] = height[better], zoom
    fits = chosen[pairs.candidate]
    every = np.arange(len(fits))
    apart = [along[fits, every] - peak[fits, pairs.candidate] for along, peak in zip(bins, peaks, strict=True)]
    agree = (np.abs(apart[0]) <= tolerance) & (np.abs(apart[1]) <= tolerance)
    moved = [
        np.bincount(pairs.candidate[agree], (weight * along[fits, every])[agree], candidates) for along in displacement
    ]
    shift = np.stack(moved, axis=1) / np.maximum(score, 1e-9)[:, None] * roots[chosen]
    scale = np.ones(candidates)
    if measured:
        scale = _scale(pairs.candidate[agree], ours[:, agree], theirs[:, agree], weight[agree], candidates)
    return Agreement(
        np.sqrt(np.minimum(score / max(float(distinct.sum()), 1e-6), 1)).astype(np.float32),
        np.rint(np.where(score[:, None] > 0, shift, 0)).astype(np.intp),
        np.where(score > 0, np.array(zooms)[chosen], 1).astype(np.float32),
        np.clip(scale, 1 / LARGEST_SCALE, LARGEST_SCALE).astype(np.float32),
    )


def _scale(candidate: Indices, ours: Doubles, theirs: Doubles, weight: Doubles, candidates: int) -> Doubles:
    """By how much distances between cells grow, float64 (candidates,): ridge regression of `theirs` on `ours`.

    Both are (rows, columns) of cells, float64 (2, pairs). The ridge pulls towards 1.
    """

    def total(values: Doubles) -> Doubles:
        return np.bincount(candidate, values, candidates).astype(np.float64)

    whole = np.maximum(total(weight), 1e-9)
    spread, growth = np.zeros(candidates), np.zeros(candidates)
    for own, moved in zip(ours, theirs - ours, strict=True):
        around = own - (total(weight * own) / whole)[candidate]
        spread += total(weight * around**2)
        growth += total(weight * around * moved)
    return 1 + growth / (spread + CERTAINTY)


def _centred(cell: Indices, shape: tuple[int, int]) -> tuple[Doubles, Doubles]:
    """Rows and columns of cells from the grid's centre, float64 (n,) each."""
    row, column = np.divmod(cell, shape[1])
    return row - (shape[0] - 1) / 2, column - (shape[1] - 1) / 2


def _peaks(
    candidate: Indices,
    bins: Sequence[Indices],
    weight: Doubles,
    candidates: int,
    shape: tuple[int, int],
    tolerance: int,
) -> tuple[Doubles, tuple[Indices, Indices]]:
    """Largest weight within `tolerance` of one displacement of at most half the grid, and where; of equals the first.

    Parameters
    ----------
    candidate : intp of shape (pairs,)
    bins : (rows, columns), intp of shape (zooms, pairs) each
        Rounded displacement of each pair under each zoom.
    weight : float64 of shape (pairs,)
    candidates : int
    shape : (int, int)
        Rows and columns of the grids.
    tolerance : int

    Returns
    -------
    heights : float64 of shape (zooms, candidates)
    peaks : (rows, columns), intp of shape (zooms, candidates) each
    """
    zooms, window = len(bins[0]), 2 * tolerance + 1
    reach = [half // 2 for half in shape]
    rows, columns = (2 * (half + tolerance) + 1 for half in reach)
    # Vote for every zoom at once; what moved too far votes with nothing, somewhere.
    down, across = (along + (half + tolerance) for along, half in zip(bins, reach, strict=True))
    within = (down >= 0) & (down < rows) & (across >= 0) & (across < columns)
    index = ((np.arange(zooms)[:, None] * candidates + candidate) * rows + down) * columns + across
    votes = np.bincount(
        np.where(within, index, 0).ravel(), np.where(within, weight, 0).ravel(), zooms * candidates * rows * columns
    ).reshape(zooms * candidates, rows, columns)
    rows, columns = rows - window + 1, columns - window + 1
    votes = sum(votes[:, i : i + rows] for i in range(1, window)) + votes[:, :rows]
    votes = sum(votes[:, :, i : i + columns] for i in range(1, window)) + votes[:, :, :columns]
    flat = votes.reshape(zooms * candidates, rows * columns)
    peak = flat.argmax(axis=1)
    height = flat[np.arange(len(flat)), peak].reshape(zooms, candidates)
    row, column = np.divmod(peak.reshape(zooms, candidates), columns)
    return height, (row - reach[0], column - reach[1])
