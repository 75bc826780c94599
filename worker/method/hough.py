"""Hough voting: the displacement and zoom on which corresponding cells of two images agree."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Doubles, Floats, Indices

Int32s = npt.NDArray[np.int32]
Along = tuple[Doubles, Doubles]
"""Rows and columns of cells, from the grid's centre."""

ZOOMS = (1.0, 0.8, 1.25)
"""Zooms that are tried: size in the candidate relative to the query. Ties go to the earlier."""

LARGEST_SCALE = 2.0
"""Scales are clipped to this and its inverse: larger estimates rest on few cells and are noise."""

CERTAINTY = 250.0
"""Ridge of the scale regression: at a spread (sum of weight times squared distance from the centre, in cells) of this
size the estimate is pulled halfway to 1."""

ASPECT_STEPS = 8
"""Cell aspects are rounded to this many steps an octave: images of nearly one shape count as one shape, and the
rounding error stays below the tolerance."""

TOLERANCE = 2
"""Largest deviation of a correspondence from the common displacement, in cells: room for parallax and perspective."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Mutually nearest cells of a query and several candidates, one row per pair.

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
        Root of the weight that agrees over the largest possible weight, 0..1; 1 for an image against itself when no
        two of its cells are equal.
    shifts : intp of shape (candidates, 2)
        (rows, columns) by which the query's centre moves: the mean over the pairs that agree, in cells of the query.
    scales : float32 of shape (candidates,)
        Size in the candidate relative to the query, 0.5..2, estimated from the pairs that agree, and shrunk towards 1
        where they are few or close together.
    cells : float32 of shape (candidates, rows * columns)
        Share of the largest possible weight that agrees at each query cell, at least 0; the root of a candidate's sum
        is its score.
    """

    scores: Floats
    shifts: Indices
    scales: Floats
    cells: Floats


def cell_aspects(query: tuple[float, float], candidates: Sequence[tuple[float, float]]) -> Doubles:
    """Cell aspects: height and width of the candidates' cells relative to those of the query.

    A grid has the same rows and columns whatever the image's shape, so the cells of a portrait image are narrow and
    high, and those of a landscape image wide and low.

    Parameters
    ----------
    query, candidates : (float, float)
        Width and height of the images, as fractions of their longer sides.

    Returns
    -------
    float64 of shape (candidates, 2)
        Heights and widths, rounded to `ASPECT_STEPS` steps an octave; 1 where the shapes are the same.
    """
    ratios = np.array(candidates, np.float64).reshape(-1, 2)[:, ::-1] / np.array(query, np.float64)[::-1]
    rounded: Doubles = np.exp2(np.rint(np.log2(ratios) * ASPECT_STEPS) / ASPECT_STEPS)
    return rounded


def agreement(
    pairs: Correspondences,
    burstiness: Floats,
    shape: tuple[int, int],
    candidates: int,
    *,
    cell_aspect: Doubles | None = None,
    estimate_scales: bool = True,
) -> Agreement:
    """The largest weight of correspondences that agree on one displacement (a Hough transform).

    Parameters
    ----------
    pairs : Correspondences
    burstiness : float32 of shape (rows * columns,)
        Burstiness weight of each query cell, at least 0.
    shape : (int, int)
        Rows and columns of the grids.
    candidates : int
        Number of candidates, including those without a correspondence.
    cell_aspect : float64 of shape (candidates, 2), optional
        Height and width of each candidate's cells relative to the query's, see `cell_aspects`; without it, all 1.
    estimate_scales : bool
        If not, scales are all 1.

    Returns
    -------
    Agreement

    Notes
    -----
    A correspondence of cosine c weighs c^2 times the burstiness weight of its query cell. Displacements of more than
    half the image are left out: the overlap would be too small. With zoom z a query cell p (from the image's centre)
    is expected at z p + t; both sides are divided by sqrt(z) so that `TOLERANCE` is the same in either direction.
    The root brings similarities of different channels closer in size: without it the channel with larger ones would
    decide alone.
    """
    cell_aspect = np.ones((candidates, 2)) if cell_aspect is None else cell_aspect
    won = winning(pairs, burstiness, shape, candidates, cell_aspect)
    score, weight = won.heights, won.weights
    candidate = pairs.candidate[won.pairs]
    ours = _centred(pairs.query_cell[won.pairs], shape)
    down, across = _centred(pairs.candidate_cell[won.pairs], shape)
    theirs = down * cell_aspect[candidate, 0], across * cell_aspect[candidate, 1]
    moved = [
        np.bincount(candidate, weight * (there - here * won.zooms[candidate]), candidates)
        for here, there in zip(ours, theirs, strict=True)
    ]
    shift = np.stack(moved, axis=1) / np.maximum(score, 1e-9)[:, None]
    scale = _scale(candidate, ours, theirs, weight, candidates) if estimate_scales else np.ones(candidates)
    largest, cells = largest_weight(burstiness), shape[0] * shape[1]
    agreeing = np.bincount(candidate * cells + pairs.query_cell[won.pairs], weight, candidates * cells)
    return Agreement(
        np.sqrt(np.minimum(score / largest, 1)).astype(np.float32),
        np.rint(np.where(score[:, None] > 0, shift, 0)).astype(np.intp),
        np.clip(scale, 1 / LARGEST_SCALE, LARGEST_SCALE).astype(np.float32),
        (agreeing / largest).reshape(candidates, cells).astype(np.float32),
    )


@dataclass(frozen=True, eq=False)
class Winning:
    """Correspondences that agree with the displacement and zoom of the largest weight.

    Parameters
    ----------
    pairs : intp of shape (agreeing,)
        Rows of the correspondences that agree, in their order.
    weights : float64 of shape (agreeing,)
        Of those rows; they sum to `heights` by candidate.
    heights : float64 of shape (candidates,)
        The largest weight of each candidate.
    zooms : float64 of shape (candidates,)
        Its zoom; 1 where nothing corresponds.
    """

    pairs: Indices
    weights: Doubles
    heights: Doubles
    zooms: Doubles


def winning(
    pairs: Correspondences, burstiness: Floats, shape: tuple[int, int], candidates: int, cell_aspect: Doubles
) -> Winning:
    """The correspondences that make the score of each candidate; parameters and weights as in `agreement`."""
    weight = pairs.cosine.astype(np.float64) ** 2 * burstiness[pairs.query_cell]
    slots, voted = _votes(pairs, shape, cell_aspect)
    heights, peaks = _peaks(pairs.candidate, voted, weight, candidates, slots)
    score, chosen = np.zeros(candidates), np.zeros(candidates, np.intp)
    for zoom, height in enumerate(heights):
        better = height > score + 1e-9
        score[better], chosen[better] = height[better], zoom
    peak = peaks[chosen, np.arange(candidates)]
    agree = np.flatnonzero(slots.near(voted[chosen[pairs.candidate], np.arange(len(weight))], peak[pairs.candidate]))
    return Winning(agree, weight[agree], score, np.array(ZOOMS)[chosen])


def largest_weight(burstiness: Floats) -> float:
    """The weight of an image's cells against themselves: the sum of burstiness weights, at least 1e-6."""
    return max(float(burstiness.sum()), 1e-6)


def _scale(candidate: Indices, ours: Along, theirs: Along, weight: Doubles, candidates: int) -> Doubles:
    """Scale of each candidate, float64 (candidates,): slope of the ridge regression of `theirs` on `ours`.

    Both are rows and columns of cells. The ridge `CERTAINTY` pulls the slope towards 1.
    """

    def total(values: Doubles) -> Doubles:
        return np.bincount(candidate, values, candidates).astype(np.float64)

    whole = np.maximum(total(weight), 1e-9)
    spread, growth = np.zeros(candidates), np.zeros(candidates)
    for own, other in zip(ours, theirs, strict=True):
        around = own - (total(weight * own) / whole)[candidate]
        spread += total(weight * around**2)
        growth += total(weight * around * (other - own))
    return 1 + growth / (spread + CERTAINTY)


def _centred(cell: Indices, shape: tuple[int, int]) -> Along:
    """Rows and columns of cells from the grid's centre, float64 (n,) each."""
    row, column = np.divmod(cell, shape[1])
    return row - (shape[0] - 1) / 2, column - (shape[1] - 1) / 2


@dataclass(frozen=True, eq=False)
class _Slots:
    """Bins of the Hough transform: rounded displacements, row by row, and a last row for those out of range.

    Parameters
    ----------
    rows, columns : int
        Number of bins along each axis, the last row not counted.
    of : int32 of shape (zooms, cells * cells)
        Bin of every pair of cells, at index query cell * cells + candidate cell.
    """

    rows: int
    columns: int
    of: Int32s

    def near(self, slots: Int32s, peaks: Indices) -> Booleans:
        """Whether each bin lies within `TOLERANCE` of its peak; windows around peaks never reach the last row."""
        down, across = (a - b for a, b in zip(divmod(slots, self.columns), divmod(peaks, self.columns), strict=True))
        close: Booleans = (np.abs(down) <= TOLERANCE) & (np.abs(across) <= TOLERANCE)
        return close


def _votes(pairs: Correspondences, shape: tuple[int, int], cell_aspect: Doubles) -> tuple[_Slots, Int32s]:
    """The bins, and the bin that each pair votes for under each zoom: int32 (zooms, pairs)."""
    slots = _slots(shape)
    voted = slots.of[:, pairs.query_cell * (shape[0] * shape[1]) + pairs.candidate_cell]
    other = np.flatnonzero((cell_aspect != 1).any(axis=1)[pairs.candidate])
    if len(other):
        down, across = _centred(pairs.candidate_cell[other], shape)
        height, width = cell_aspect[pairs.candidate[other]].T
        ours = _centred(pairs.query_cell[other], shape)
        voted[:, other] = _displaced(ours, (down * height, across * width), shape)
    return slots, voted


@lru_cache(maxsize=16)
def _slots(shape: tuple[int, int]) -> _Slots:
    """Bins for displacements of at most half a grid of `shape` plus `TOLERANCE`."""
    down, across = _centred(np.arange(shape[0] * shape[1]), shape)
    slots = _displaced((down[:, None], across[:, None]), (down, across), shape)
    rows, columns = _extremes(shape)
    return _Slots(2 * rows + 1, 2 * columns + 1, slots.reshape(len(ZOOMS), -1))


def _displaced(ours: Along, theirs: Along, shape: tuple[int, int]) -> Int32s:
    """Bins of pairs of positions under each zoom, int32 (zooms, ...); positions are broadcast against each other."""
    rows, columns = _extremes(shape)
    roots = np.sqrt(np.array(ZOOMS)).reshape(-1, *(1 for _ in np.broadcast(ours[0], theirs[0]).shape))
    down, across = (
        np.rint(there / roots - here * roots) + most
        for here, there, most in zip(ours, theirs, (rows, columns), strict=True)
    )
    within = (down >= 0) & (down <= 2 * rows) & (across >= 0) & (across <= 2 * columns)
    width = 2 * columns + 1
    return np.where(within, down * width + across, (2 * rows + 1) * width).astype(np.int32)


def _extremes(shape: tuple[int, int]) -> tuple[int, int]:
    """The largest displacement that has a bin, in rows and columns."""
    return shape[0] // 2 + TOLERANCE, shape[1] // 2 + TOLERANCE


def _peaks(
    candidate: Indices, voted: Int32s, weight: Doubles, candidates: int, slots: _Slots
) -> tuple[Doubles, Indices]:
    """Largest weight within `TOLERANCE` of one displacement of at most half the grid, and its bin; ties: the first.

    Parameters
    ----------
    candidate : intp of shape (pairs,)
    voted : int32 of shape (zooms, pairs)
        Bin of each pair under each zoom.
    weight : float64 of shape (pairs,)
    candidates : int
    slots : _Slots

    Returns
    -------
    heights : float64 of shape (zooms, candidates)
    peaks : intp of shape (zooms, candidates)
        Bins.
    """
    count = len(voted) * candidates
    # Candidates are the last axis, so that windows are summed over contiguous memory.
    index = voted * count + (np.arange(len(voted))[:, None] * candidates + candidate)
    votes = np.bincount(index.ravel(), np.tile(weight, len(voted)), (slots.rows + 1) * slots.columns * count)
    kept = np.asarray(votes, np.float64).reshape(slots.rows + 1, slots.columns, count)[: slots.rows]
    heights = _running(_running(kept).swapaxes(0, 1))
    columns, rows = heights.shape[:2]
    flat = heights.swapaxes(0, 1).reshape(rows * columns, count)
    first = flat.argmax(axis=0)
    row, column = np.divmod(first, columns)
    peak = (row + TOLERANCE) * slots.columns + column + TOLERANCE
    height = flat[first, np.arange(count)]
    return height.reshape(len(voted), candidates), peak.reshape(len(voted), candidates)


def _running(values: Doubles) -> Doubles:
    """Sums over windows along the first axis, put together from sums of 1, 2, 4, ... neighbours."""
    window = 2 * TOLERANCE + 1
    count = len(values) - window + 1
    total, done, sums, size = np.zeros(()), 0, values, 1
    while True:
        if window & size:
            part = sums[done : done + count]
            total, done = total + part if done else part, done + size
        if done == window:
            return total
        sums, size = sums[:-size] + sums[size:], size * 2
