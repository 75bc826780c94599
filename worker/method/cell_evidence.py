"""Which cells decided: those that make the dense similarity of one candidate, and what sets it apart from a rival.

The ranking needs only the sum of what agrees (`worker.method.dense_cells.compare`). People want to see where it is.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import DETAIL, Booleans, Doubles, Indices, Int8s
from worker.method import hough
from worker.method.cell_regions import bounding_box, smoothed
from worker.method.channel_fusion import length, slice_channel
from worker.method.context_graph import Components
from worker.method.dense_cells import burstiness_weight, correspondences

LEAST_DIFFERENCE = 0.25
"""Cells differ when the smoothed difference of their weights is at least this share of the largest one."""

MOST_REGIONS = 5
"""Regions that a contrast has at most."""


@dataclass(frozen=True, eq=False)
class CellEvidence:
    """The cells of a query and one candidate that agree on the winning displacement and zoom.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of both grids. Cells are numbered row by row.
    query_cell, candidate_cell : intp of shape (pairs,)
        Each at most once, ordered by query cell.
    weight : float64 of shape (pairs,)
        Share of the largest possible weight, greater than 0; their sum is the square of the similarity.
    channel : str or None
        The channel that was compared alone; None for all channels together.
    """

    shape: tuple[int, int]
    query_cell: Indices
    candidate_cell: Indices
    weight: Doubles
    channel: str | None = None

    @property
    def similarity(self) -> float:
        """Similarity of the dense cells before the scale penalty, 0..1."""
        return float(np.sqrt(self.weight.sum()))

    def of_query(self) -> Doubles:
        """Weight of each cell of the query, float64 (rows, columns); 0 where it does not agree."""
        return self._spread(self.query_cell)

    def of_candidate(self) -> Doubles:
        """Weight of each cell of the candidate, float64 (rows, columns); 0 where it does not agree."""
        return self._spread(self.candidate_cell)

    def _spread(self, cells: Indices) -> Doubles:
        spread = np.zeros(self.shape[0] * self.shape[1])
        spread[cells] = self.weight
        return spread.reshape(self.shape)


@dataclass(frozen=True)
class Region:
    """Neighbouring cells of the query that speak for one of two candidates.

    Parameters
    ----------
    centre : (float, float)
        (x, y) of its bounding box, in fractions of the image's longer side.
    extent : (float, float)
        (width, height) of its bounding box, in the same unit.
    strength : float
        Sum of the differences of weight: above 0 for the first candidate, below 0 for the rival.
    """

    centre: tuple[float, float]
    extent: tuple[float, float]
    strength: float


@dataclass(frozen=True, eq=False)
class Contrast:
    """Where a query resembles the first candidate more than a rival, and where less.

    Parameters
    ----------
    difference : float64 of shape (rows, columns)
        Weight of each cell of the query in the first less its weight in the rival. The sum is the difference of the
        squared similarities.
    numbers : int32 of shape (rows, columns)
        1 for cells of the first of `regions`, 2 for those of the second, ...; 0 elsewhere.
    regions : tuple of Region
        `MOST_REGIONS` at most, largest strength of either sign first.
    """

    difference: Doubles
    numbers: npt.NDArray[np.int32]
    regions: tuple[Region, ...]


def agreeing(
    query: Int8s,
    candidate: Int8s,
    channels: Collection[str],
    *,
    cell_aspect: Doubles | None = None,
    align_scale: float = 0.0,
) -> CellEvidence:
    """The agreeing cells of a query and one candidate, by that comparison which counted in the ranking.

    Parameters
    ----------
    query, candidate : int8 of shape (rows, columns, dimensions)
        At the same resolution, not empty.
    channels : collection of str
        The channels that the cells join.
    cell_aspect : float64 of shape (2,), optional
        Height and width of the candidate's cells relative to the query's; without it, 1.
    align_scale : float
        Factor on the similarity of detail alone (`worker.method.evidence.DenseEvidence`): when that is larger, its
        cells are returned, with weights times the square of the factor. 0 compares all channels together only.

    Raises
    ------
    DescriptorMismatch, ValueError
        As `worker.method.dense_cells.correspondences`.
    """
    joined = _agreeing(query, candidate, cell_aspect)
    if align_scale <= 0:
        return joined
    ours, theirs = (slice_channel(cells, channels, DETAIL) for cells in (query, candidate))
    alone = _agreeing(ours, theirs, cell_aspect, length(ours), factor=align_scale, channel=DETAIL)
    return alone if alone.similarity > joined.similarity else joined


def contrast(first: CellEvidence, rival: CellEvidence, extent: tuple[float, float], components: Components) -> Contrast:
    """Where a query speaks for the first of two candidates, and where for the other.

    Parameters
    ----------
    first, rival : CellEvidence
        Of the same query.
    extent : (float, float)
        (width, height) of the query image as fractions of its longer side.
    components : Components

    Notes
    -----
    Single cells match by chance. Regions are found in the difference averaged over 3 x 3 cells, and consist of those
    cells whose own difference has the region's sign; the strength sums the differences themselves.
    """
    difference = first.of_query() - rival.of_query()
    smooth = smoothed(difference, "constant")
    least = LEAST_DIFFERENCE * float(np.abs(smooth).max(initial=0))
    found: list[tuple[float, Booleans]] = []
    for sign in (1, -1):
        parts = components((sign * smooth >= max(least, 1e-12)) & (sign * difference > 0))
        for number in range(1, int(parts.max(initial=0)) + 1):
            region = parts == number
            found.append((float(difference[region].sum()), region))
    found.sort(key=lambda one: -abs(one[0]))  # a stable sort: ties in the order of their first cells, the first's first
    found = found[:MOST_REGIONS]
    numbers = np.zeros(difference.shape, np.int32)
    for number, (_, region) in enumerate(found, start=1):
        numbers[region] = number
    regions = tuple(Region(*bounding_box(cells, extent), strength) for strength, cells in found)
    return Contrast(difference, numbers, regions)


def _agreeing(
    query: Int8s,
    candidate: Int8s,
    cell_aspect: Doubles | None,
    length: float = 1.0,
    *,
    factor: float = 1.0,
    channel: str | None = None,
) -> CellEvidence:
    """The agreeing cells by one comparison; the similarity counts `factor` times, and is 1 at most."""
    shape = (query.shape[0], query.shape[1])
    pairs = correspondences(query, candidate[None], length=length)
    burstiness = burstiness_weight(query, length=length)
    aspect = np.ones(2) if cell_aspect is None else cell_aspect
    won = hough.winning(pairs, burstiness, shape, 1, aspect[None])
    weight = won.weights / hough.largest_weight(burstiness) * factor**2
    kept = weight > 0
    weight = weight[kept] / max(1.0, float(weight.sum()))
    return CellEvidence(
        shape, pairs.query_cell[won.pairs][kept], pairs.candidate_cell[won.pairs][kept], weight, channel
    )
