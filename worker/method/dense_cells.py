"""Dense cells: a coarse grid of embeddings, compared by mutually best cells that agree on one displacement.

A cell joins the embeddings of all channels, so that one comparison weighs the channels cell by cell.

Each cell of the query looks for its best counterpart anywhere in the candidate; pairs that are each other's best are
correspondences. Those with an image of the same place agree on one displacement (a shift, and a zoom when the camera
moved forward), so the similarity is the largest weight of correspondences that agree.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from schemas.description import Doubles, Floats, Indices, Int8s
from schemas.errors import DescriptorMismatch
from worker.method.byte_vectors import Product, float_product, scale
from worker.method.hough import Agreement, Correspondences, agreement
from worker.method.unit_length import unit

BLOCK = 200_000
"""Cosines computed at once: a larger block would leave the processor's cache before its maxima are found."""

ROUNDING = 1e-6
"""Cells of at most this length count as zero: the rest is rounding error."""

APART = 2
"""Cells further apart than this, in rows or columns, count as showing different things; neighbours show the same."""


def grid(field: Floats, rows: int, columns: int) -> Floats:
    """Average a field of embeddings over equal cells, and subtract the image's mean.

    Parameters
    ----------
    field : float32 of shape (height, width, channels)
        Unit length.
    rows, columns : int
        At least 1; more than `height` or `width` is allowed.

    Returns
    -------
    float32 of shape (rows, columns, channels)
        Unit length; zero where a cell equals the image's mean.

    Notes
    -----
    Without centring, the component common to all cells (light, camera) dominates every cosine.
    """
    cells = average(field, rows, columns)
    return unit(cells - cells.mean(axis=(0, 1)), ROUNDING)


def average(field: Floats, rows: int, columns: int) -> Floats:
    """Average a field of embeddings over equal cells; parameters as of `grid`, the result of unit length too."""
    height, width, channels = field.shape
    down = (_coverage(height, rows) @ field.reshape(height, -1)).reshape(rows, width, channels)
    return unit(_coverage(width, columns) @ down, ROUNDING)


def reduce(cells: Floats, projection: Floats) -> Floats:
    """Cells in fewer dimensions.

    Parameters
    ----------
    cells : float32 of shape (rows, columns, channels)
    projection : float32 of shape (channels, dimensions)
        Orthonormal columns, the principal directions of cells of a training set (`worker.method.vocabulary.fit_cells`).

    Returns
    -------
    float32 of shape (rows, columns, dimensions)
        Unit length.

    Raises
    ------
    DescriptorMismatch
        The two disagree on the number of channels.
    """
    if cells.shape[-1] != projection.shape[0]:
        raise DescriptorMismatch(got=cells.shape[-1], want=projection.shape[0])
    return unit(cells @ projection, ROUNDING)


def join(cells: Mapping[str, Floats], shares: Mapping[str, float]) -> Floats:
    """One vector per cell from those of all channels, whose cosine is the mean of the channels' cosines.

    Parameters
    ----------
    cells : mapping of channel to float32 of shape (rows, columns, dimensions)
        Unit length, as `reduce` gives them.
    shares : mapping of channel to float
        Weight of each channel in the mean, greater than 0, scaled to sum to 1 over the channels that `cells` has; a
        channel that is not named is left out. When none is named all count the same.

    Returns
    -------
    float32 of shape (rows, columns, sum of dimensions)
        Unit length, channels by name; of shape (0, 0, 0) when there are none.
    """
    named = sorted(name for name in cells if name in shares or not shares)
    if not named:
        return np.zeros((0, 0, 0), np.float32)
    total = sum(shares.get(name, 1.0) for name in named)
    joined: Floats = np.concatenate(
        [cells[name] * np.float32(np.sqrt(shares.get(name, 1.0) / total)) for name in named], axis=-1
    )
    return joined


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
    return unit(down[..., 0::2, :] + down[..., 1::2, :], ROUNDING)


def burstiness_weight(cells: Int8s | Floats, product: Product = float_product, length: float = 1.0) -> Floats:
    """Burstiness weight: how unlike the rest of its own image each cell is.

    Parameters
    ----------
    cells : int8 or float32 of shape (rows, columns, dimensions)
        Of unit length, or as `quantise` stores them.
    product : Product
    length : float
        Length of the vectors, less than 1 where they are slices of joined cells.

    Returns
    -------
    float32 of shape (rows * columns,)
        1 minus the largest cosine with a cell further away than `APART`, 0..1; 1 where there is no such cell.

    Notes
    -----
    Sky or bare floor fills many cells, each of which has a counterpart in any other sky. Structure that occurs once in
    an image is more distinctive (burstiness: Jegou et al. 2009).
    """
    rows, columns = cells.shape[:2]
    flat = cells.reshape(rows * columns, cells.shape[2])
    products = product(flat, flat)
    products *= _far(rows, columns)
    # The matrix is symmetric; the maximum along columns is quicker.
    closest = products.max(axis=0).astype(np.float32) * np.float32((scale(cells) / length) ** 2)
    unlike: Floats = 1 - np.clip(closest, 0, 1)
    return unlike


def correspondences(
    query: Int8s | Floats, candidates: Int8s | Floats, product: Product = float_product, length: float = 1.0
) -> Correspondences:
    """Pairs of cells that are each other's best, for each candidate.

    Parameters
    ----------
    query : int8 or float32 of shape (rows, columns, dimensions)
        Of unit length, or as `quantise` stores them.
    candidates : int8 or float32 of shape (candidates, rows, columns, dimensions)
    product : Product
    length : float
        Length of the vectors of both, less than 1 where they are slices of joined cells.

    Returns
    -------
    Correspondences
        Only pairs of positive cosine; ties go to the first cell.

    Raises
    ------
    DescriptorMismatch
        Query and candidates differ in dimensions.
    ValueError
        Query and candidates differ in rows or columns.
    """
    if query.shape[-1] != candidates.shape[-1]:
        raise DescriptorMismatch(got=query.shape[-1], want=candidates.shape[-1])
    if query.shape[:2] != candidates.shape[1:3]:
        raise ValueError(f"a grid of {query.shape[:2]} cells cannot be compared with one of {candidates.shape[1:3]}")
    cells = query.shape[0] * query.shape[1]
    ours = query.reshape(cells, query.shape[-1])
    theirs = candidates.reshape(len(candidates), cells, query.shape[-1])
    best, largest, highest = _best(ours, theirs, product)
    which, cell = np.nonzero((largest == np.take_along_axis(highest, best, axis=1)) & (largest > 0))
    counterpart = best[which, cell]
    # Among equal query cells with one best counterpart the first keeps it: in reversed order it is written last.
    taken = which * cells + counterpart
    owner = np.empty(len(candidates) * cells, np.intp)
    owner[taken[::-1]] = cell[::-1]
    first = owner[taken] == cell
    which, cell, counterpart = which[first], cell[first], counterpart[first]
    cosine = largest[which, cell] * np.float32(scale(query) * scale(candidates) / length**2)
    return Correspondences(which, cell, counterpart, np.minimum(cosine, 1))


def compare(
    query: Int8s | Floats,
    candidates: Int8s | Floats,
    product: Product = float_product,
    length: float = 1.0,
    *,
    cell_aspect: Doubles | None = None,
    estimate_scales: bool = True,
    burstiness: Floats | None = None,
) -> Agreement:
    """How well the cells of several candidates agree with those of a query.

    Parameters
    ----------
    query : int8 or float32 of shape (rows, columns, dimensions)
    candidates : int8 or float32 of shape (candidates, rows, columns, dimensions)
    product : Product
    length : float
        Length of the vectors of both, less than 1 where they are slices of joined cells.
    cell_aspect : float64 of shape (candidates, 2), optional
        Height and width of the candidates' cells relative to the query's (`worker.method.hough.cell_aspects`); without
        it, all 1.
    estimate_scales : bool
        If not, scales are all 1.
    burstiness : float32 of shape (rows * columns,), optional
        `burstiness_weight` of the query, where that is known.

    Raises
    ------
    DescriptorMismatch, ValueError
        As `correspondences`.
    """
    pairs = correspondences(query, candidates, product, length)
    if burstiness is None:
        burstiness = burstiness_weight(query, product=product, length=length)
    shape = query.shape[0], query.shape[1]
    return agreement(
        pairs, burstiness, shape, len(candidates), cell_aspect=cell_aspect, estimate_scales=estimate_scales
    )


def scale_penalty(scales: Floats, exponent: float) -> Floats:
    """Factor on the similarity of candidates that show the place larger or smaller than the query does.

    Parameters
    ----------
    scales : float32 of shape (candidates,)
        As in `worker.method.hough.Agreement`.
    exponent : float
        At least 0.

    Returns
    -------
    float32 of shape (candidates,)
        min(s, 1 / s) ** exponent: 1 at the same scale.

    Notes
    -----
    Successive views along a path show the same structures, and their cells agree nearly equally well. The view taken
    nearest to the query shows them at the same size.
    """
    near: Floats = np.minimum(scales, 1 / scales) ** np.float32(exponent)
    return near


@lru_cache(maxsize=64)
def _coverage(pixels: int, cells: int) -> Floats:
    """Share of each cell that each pixel covers, float32 (cells, pixels); rows sum to 1."""
    edges = np.linspace(0, pixels, cells + 1)
    start = np.arange(pixels)
    overlap = np.minimum(edges[1:, None], start + 1) - np.maximum(edges[:-1, None], start)
    share: Floats = (np.clip(overlap, 0, None) * cells / pixels).astype(np.float32)
    return share


@lru_cache(maxsize=16)
def _far(rows: int, columns: int) -> Int8s:
    """1 where cells lie more than `APART` rows or columns from one another, 0 elsewhere, int8 (cells, cells)."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    distance = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
    far: Int8s = (distance > APART).astype(np.int8)
    return far


def _best(ours: Int8s | Floats, theirs: Int8s | Floats, product: Product) -> tuple[Indices, Floats, Floats]:
    """Each cell's best counterpart: (cells, d) against (candidates, cells, d).

    Returns
    -------
    best : intp of shape (candidates, cells)
        For each query cell the candidate's cell with the largest product; ties go to the first.
    largest : float32 of shape (candidates, cells)
        The largest product of each query cell.
    highest : float32 of shape (candidates, cells)
        The largest product of each candidate cell with any query cell.
    """
    count, cells = theirs.shape[:2]
    best = np.empty((count, cells), np.intp)
    largest, highest = np.empty((2, count, cells), np.float32)
    block = max(1, BLOCK // max(1, cells**2))
    for at in range(0, count, block):
        some = theirs[at : at + block]
        products = product(ours, some.reshape(-1, some.shape[2]))
        highest[at : at + block] = products.max(axis=0).reshape(len(some), cells)
        found = products.reshape(cells, len(some), cells).argmax(axis=2)
        starts = np.arange(0, products.size, cells).reshape(found.shape)
        best[at : at + block] = found.T
        largest[at : at + block] = products.ravel()[starts + found].T
    return best, largest, highest
