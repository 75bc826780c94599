"""The shortlist: from many views that the histograms hardly tell apart to those that are compared in full.

In a large map thousands of views have histograms much like the query's, and the right one may be the two hundredth. How
many views are worth a look shows in the distances: where those after the first are nearly as near, more are taken. All
of these are compared by a cheap measure, and as many go on as ever.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Doubles, Floats, Indices, Int8s
from schemas.records import Candidates
from worker.method import dense_cells
from worker.method.byte_vectors import Product, float_product, quantise, scale

UNRELATED = float(np.sqrt(2))
"""Distance of two unit vectors that have nothing in common."""

NEAR = 0.6
"""How far on the way from the nearest view's distance to `UNRELATED` a view is still worth a look."""

GUARANTEED = 10
"""The nearest views of each channel stay, whatever their cells say."""


def worth_a_look(candidates: Candidates, least: int, most: int) -> Booleans:
    """The candidates that are near in some channel, judged by how its distances grow.

    Parameters
    ----------
    candidates : Candidates
        With at least `most` views of each channel, or all of the map.
    least, most : int
        How many of each channel are taken at least and at most.

    Returns
    -------
    bool of shape (candidates,)
        In each channel those within `NEAR` of the way from the nearest view to an unrelated one, within both limits.
    """
    chosen = np.zeros(len(candidates.seqs), np.bool_)
    for name, ranks in candidates.ranks.items():
        found = ranks > 0
        if found.any():
            distances = candidates.distances[name]
            nearest = distances[found].min()
            near = distances < nearest + NEAR * (UNRELATED - nearest)
            chosen |= found & ((ranks <= least) | (near & (ranks <= most)))
    return chosen


def nearest(candidates: Candidates, count: int) -> Booleans:
    """The `count` nearest of each channel, bool of shape (candidates,)."""
    chosen = np.zeros(len(candidates.seqs), np.bool_)
    for ranks in candidates.ranks.values():
        chosen |= (ranks > 0) & (ranks <= count)
    return chosen


def only(candidates: Candidates, kept: Booleans) -> Candidates:
    """The candidates that a mask, bool of shape (candidates,), keeps."""
    distances = {name: values[kept] for name, values in candidates.distances.items()}
    ranks = {name: values[kept] for name, values in candidates.ranks.items()}
    return replace(
        candidates, seqs=candidates.seqs[kept], order=candidates.order[kept], distances=distances, ranks=ranks
    )


def rough_similarity(query: Int8s, candidates: Sequence[Int8s], product: Product = float_product) -> Floats:
    """How well a query's cells at a quarter size are found anywhere among candidates' cells at half size.

    A grid of one row or column has no quarter size: then the query's cells are those at half size.

    Parameters
    ----------
    query : int8 of shape (rows, columns, dimensions)
        Cells at half size.
    candidates : sequence of int8 of shape (rows, columns, dimensions)
        Cells at half size.
    product : Product

    Returns
    -------
    float32 of shape (candidates,)
        Mean square of the best cosine of each of the query's cells, 0..1; where it lies is not looked at.
    """
    quarter = quantise(dense_cells.halve(query)) if min(query.shape[:2]) > 1 else query
    rough = quarter.reshape(-1, query.shape[2])
    cells = np.stack(candidates).reshape(-1, query.shape[2])
    products = product(cells, rough).reshape(len(candidates), -1, len(rough))
    best = np.maximum(products.max(axis=1), 0).astype(np.float32) * np.float32(scale(rough) * scale(cells))
    similarity: Floats = np.square(best).mean(axis=1)
    return similarity


def shortlist(distances: Mapping[str, Floats], similarity: Floats, kept: Booleans, count: int) -> Indices:
    """Those that go on.

    Parameters
    ----------
    distances : mapping of channel to float32 of shape (n,)
        Histogram distances.
    similarity : float32 of shape (n,)
        By `rough_similarity`.
    kept : bool of shape (n,)
        Those that stay in any case.
    count : int
        How many go on, those that stay among them unless they are more.

    Returns
    -------
    intp of shape (m,)
        Ascending.

    Notes
    -----
    The order is that of the sum of two standard scores over the n views: of the similarity, and of the sum of the
    squared distances, taken negatively. So neither needs a weight that would depend on the map.
    """
    squared = np.sum([np.square(distance, dtype=np.float64) for distance in distances.values()], axis=0)
    order = np.lexsort((-(_standard(similarity) - _standard(squared)), ~kept))
    return np.sort(order[: max(count, int(kept.sum()))])


def _standard(values: npt.NDArray[np.floating]) -> Doubles:
    """Standard scores; 0 where all values are equal."""
    centred = values - values.mean(dtype=np.float64)
    deviation = float(values.std(dtype=np.float64))
    scores: Doubles = centred / deviation if deviation > 0 else np.zeros(len(values))
    return scores
