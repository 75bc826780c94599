"""Dense cells: a coarse grid of embeddings, compared by mutually best cells that agree on one displacement.

Each cell of the query looks for its best counterpart anywhere in the candidate; pairs that are each other's best are
correspondences. A picture of the same place gives correspondences that agree on how the picture moved (a shift, and
a zoom when the camera stepped forward), so the similarity is the largest weight of correspondences that do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Floats, Int8s
from schemas.errors import DescriptorMismatch

Indices = npt.NDArray[np.intp]
Doubles = npt.NDArray[np.float64]

BLOCK = 200_000
"""Cosines computed at once: more would leave the processor's cache between the product and the search in it."""

FULL_SCALE = 127
"""What a component of 1 becomes in storage."""

ZOOMS = (1.0, 0.8, 1.25)
"""How much larger the candidate may show what the query shows; the earlier wins a tie."""

TOLERANCE = 2
"""How many cells a correspondence may lie off the common displacement: room for parallax and perspective."""


APART = 2
"""Cells further from one another than this, in rows or columns, show different things."""


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
    """

    scores: Floats
    shifts: Indices
    zooms: Floats


def grid(field: Floats, rows: int, columns: int) -> Floats:
    """Average a field of embeddings over equal cells, and take the picture's mean away.

    Parameters
    ----------
    field : float32 of shape (height, width, channels)
        Unit length.
    rows, columns : int
        At least 1; more than `height` or `width` is allowed.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length; zero where a cell equals the picture's mean.

    Notes
    -----
    Without centring, what all cells have in common (the light, the camera) drowns what tells them apart.
    """
    height, width = field.shape[:2]
    down = np.einsum("rh,hwc->rwc", _coverage(height, rows), field, optimize=True)
    cells = _unit(np.einsum("kw,rwc->rkc", _coverage(width, columns), down, optimize=True))
    return _unit(cells - cells.mean(axis=(0, 1)))


def reduce(cells: Floats, projection: Floats) -> Int8s:
    """Cells as they are stored: projected, unit length, one byte a component.

    Parameters
    ----------
    cells : float32 of shape (rows, columns, channels)
    projection : float32 of shape (channels, dimensions)
        Orthonormal columns, the leading directions of general pictures' cells.

    Returns
    -------
    int8 of shape (rows, columns, dimensions)
        -127..127.

    Raises
    ------
    DescriptorMismatch
        The two disagree on the number of channels.
    """
    if cells.shape[-1] != projection.shape[0]:
        raise DescriptorMismatch(got=cells.shape[-1], want=projection.shape[0])
    return np.rint(_unit(cells @ projection) * FULL_SCALE).astype(np.int8)


def halve(cells: Int8s | Floats) -> Floats:
    """The grid of half as many rows and columns: means of 2 x 2 cells, unit length.

    Parameters
    ----------
    cells : int8 or float32 of shape (..., rows, columns, dimensions)
        An odd last row or column is left out.

    Returns
    -------
    float32 of shape (..., rows // 2, columns // 2, dimensions)
    """
    rows, columns = cells.shape[-3] // 2 * 2, cells.shape[-2] // 2 * 2
    even = cells[..., :rows, :columns, :].astype(np.float32)
    down = even[..., 0::2, :, :] + even[..., 1::2, :, :]
    return _unit(down[..., 0::2, :] + down[..., 1::2, :])


def distinctness(cells: Int8s | Floats, apart: int = APART) -> Floats:
    """How unlike the rest of its own picture each cell is.

    Parameters
    ----------
    cells : int8 or float32 of shape (rows, columns, dimensions)
        As `reduce` or `halve` gives them.
    apart : int
        Cells up to so many rows and columns away are no rest: neighbours share what they show.

    Returns
    -------
    float32 of shape (rows * columns,)
        1 less the largest cosine with a cell further away, 0..1; 1 where there is none.

    Notes
    -----
    A stretch of sky or of bare floor is many cells, each of which finds a counterpart in any other sky. What is seen
    once in a picture says more (burstiness: Jegou et al. 2009).
    """
    rows, columns = cells.shape[:2]
    flat = _as_unit(cells).reshape(rows * columns, cells.shape[2])
    cosines = flat @ flat.T
    cosines[_near(rows, columns, apart)] = 0
    unlike: Floats = 1 - np.clip(cosines.max(axis=1), 0, 1)
    return unlike


def correspondences(query: Int8s | Floats, candidates: Int8s | Floats) -> Correspondences:
    """Pairs of cells that are each other's best, for each candidate.

    Parameters
    ----------
    query : int8 or float32 of shape (rows, columns, dimensions)
        As `reduce` or `halve` gives them.
    candidates : int8 or float32 of shape (candidates, rows, columns, dimensions)

    Returns
    -------
    Correspondences
        Of equally good cells the first is the best; pairs without a positive cosine are left out.

    Raises
    ------
    DescriptorMismatch
        Query and candidates differ in dimensions.
    ValueError
        They differ in rows or columns.
    """
    if query.shape[-1] != candidates.shape[-1]:
        raise DescriptorMismatch(got=query.shape[-1], want=candidates.shape[-1])
    if query.shape[:2] != candidates.shape[1:3]:
        raise ValueError(f"a grid of {query.shape[:2]} cells cannot be compared with one of {candidates.shape[1:3]}")
    cells = query.shape[0] * query.shape[1]
    ours = _as_unit(query).reshape(cells, query.shape[-1])
    theirs = _as_unit(candidates).reshape(len(candidates), cells, query.shape[-1])
    block = max(1, BLOCK // max(1, cells**2))
    found = [_mutual(ours, theirs[at : at + block], at) for at in range(0, max(1, len(candidates)), block)]
    return Correspondences(*(np.concatenate(column) for column in zip(*found, strict=True)))


def agreement(
    pairs: Correspondences,
    distinct: Floats,
    shape: tuple[int, int],
    candidates: int,
    zooms: Sequence[float] = ZOOMS,
    tolerance: int = TOLERANCE,
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
    reach = np.array(shape) // 2
    weight = pairs.cosine.astype(np.float64) ** 2 * distinct[pairs.query_cell]
    ours, theirs = _centred(pairs.query_cell, shape), _centred(pairs.candidate_cell, shape)
    score, shift, chosen = np.zeros(candidates), np.zeros((candidates, 2)), np.ones(candidates)
    for zoom in zooms:
        root = np.sqrt(zoom)
        displacement = theirs / root - ours * root
        bins = np.rint(displacement).astype(np.intp)
        height, peak = _peaks(pairs.candidate, bins, weight, candidates, reach, tolerance)
        agree = (np.abs(bins - peak[pairs.candidate]) <= tolerance).all(axis=1) * weight
        moved = [np.bincount(pairs.candidate, agree * displacement[:, axis], candidates) for axis in (0, 1)]
        better = height > score + 1e-9
        score[better], chosen[better] = height[better], zoom
        shift[better] = (np.stack(moved, axis=1) / np.maximum(height, 1e-9)[:, None] * root)[better]
    return Agreement(
        np.sqrt(np.minimum(score / max(float(distinct.sum()), 1e-6), 1)).astype(np.float32),
        np.rint(shift).astype(np.intp),
        chosen.astype(np.float32),
    )


def similarity(query: Int8s | Floats, candidates: Int8s | Floats) -> tuple[Floats, Indices]:
    """How well the cells of several candidates agree with those of a query.

    Parameters
    ----------
    query : int8 or float32 of shape (rows, columns, dimensions)
    candidates : int8 or float32 of shape (candidates, rows, columns, dimensions)

    Returns
    -------
    scores : float32 of shape (candidates,)
        0..1, as in `Agreement`.
    shifts : intp of shape (candidates, 2)
        (rows, columns), as in `Agreement`.

    Raises
    ------
    DescriptorMismatch, ValueError
        As `correspondences`.
    """
    pairs = correspondences(query, candidates)
    found = agreement(pairs, distinctness(query), (query.shape[0], query.shape[1]), len(candidates))
    return found.scores, found.shifts


def _unit(vectors: Floats) -> Floats:
    """Unit length along the last axis; zero where nothing but rounding is left."""
    length = np.sqrt(np.einsum("...d,...d->...", vectors, vectors))[..., None]
    unit: Floats = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 1e-6)
    return unit


def _as_unit(cells: Int8s | Floats) -> Floats:
    """Stored cells as float32; of unit length up to the rounding of storage."""
    if cells.dtype == np.int8:
        return cells.astype(np.float32) * np.float32(1 / FULL_SCALE)
    return cells.astype(np.float32, copy=False)


@lru_cache(maxsize=64)
def _coverage(pixels: int, cells: int) -> Floats:
    """Share of each cell that each pixel covers, float32 (cells, pixels); rows sum to 1."""
    edges = np.linspace(0, pixels, cells + 1)
    start = np.arange(pixels)
    overlap = np.minimum(edges[1:, None], start + 1) - np.maximum(edges[:-1, None], start)
    share: Floats = (np.clip(overlap, 0, None) * cells / pixels).astype(np.float32)
    return share


@lru_cache(maxsize=16)
def _near(rows: int, columns: int, apart: int) -> Booleans:
    """Which cells lie within `apart` rows and columns of one another, bool (cells, cells)."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    near: Booleans = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column)) <= apart
    return near


def _mutual(ours: Floats, theirs: Floats, at: int) -> tuple[Indices, Indices, Indices, Floats]:
    """Columns of `Correspondences` for candidates numbered from `at`: (cells, d) against (candidates, cells, d)."""
    cosines = np.matmul(ours, theirs.transpose(0, 2, 1))
    best = cosines.argmax(axis=2)
    cosine = np.take_along_axis(cosines, best[..., None], axis=2)[..., 0]
    highest = np.take_along_axis(cosines.max(axis=1), best, axis=1)
    which, cell = np.nonzero((cosine == highest) & (cosine > 0))
    # Of equal cells of the query that share a best counterpart, the first has it.
    counterpart = best[which, cell]
    kept = np.sort(np.unique(which * theirs.shape[1] + counterpart, return_index=True)[1])
    which, cell, counterpart = which[kept], cell[kept], counterpart[kept]
    return which + at, cell, counterpart, np.minimum(cosine[which, cell], 1)


def _centred(cell: Indices, shape: tuple[int, int]) -> Doubles:
    """(row, column) of cells from the grid's centre, float64 (n, 2)."""
    return np.stack(np.divmod(cell, shape[1]), axis=1) - (np.array(shape) - 1) / 2


def _peaks(
    candidate: Indices, bins: Indices, weight: Doubles, candidates: int, reach: Indices, tolerance: int
) -> tuple[Doubles, Indices]:
    """Largest weight within `tolerance` of one displacement of at most `reach`, and where; of equals the first.

    Returns
    -------
    height : float64 of shape (candidates,)
    peak : intp of shape (candidates, 2)
        (rows, columns) of the displacement.
    """
    rows, columns = (2 * (reach + tolerance) + 1).tolist()
    within = (np.abs(bins) <= reach + tolerance).all(axis=1)
    down, across = (bins[within] + reach + tolerance).T
    index = (candidate[within] * rows + down) * columns + across
    counted = np.asarray(np.bincount(index, weight[within], candidates * rows * columns), np.float64)
    votes = counted.reshape(candidates, rows, columns)
    window = 2 * tolerance + 1
    rows, columns = rows - window + 1, columns - window + 1
    votes = np.sum([votes[:, i : i + rows] for i in range(window)], axis=0)
    votes = np.sum([votes[:, :, i : i + columns] for i in range(window)], axis=0)
    flat = votes.reshape(candidates, rows * columns)
    peak = flat.argmax(axis=1)
    return flat[np.arange(candidates), peak], np.stack(np.divmod(peak, columns), axis=1) - reach
