"""Context graphs and their similarity (paper, "Context Graph", eq. 3-5; similarity: docs/method.md)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, ContextGraph, Floats, Indices
from worker.method.labels import LabelMap
from worker.method.unit_length import unit

Regions = npt.NDArray[np.int32]
Components = Callable[[Booleans], Regions]
"""8-connected components of a mask: (rows, columns) bool -> int32, 0 outside the mask and 1.. inside."""

TOGETHER = 4_000_000
"""Pairs of nodes whose cosines are held in memory at once."""


def build(
    labels: LabelMap,
    static: Booleans,
    embeddings: Floats,
    extent: tuple[float, float],
    components: Components,
    min_region_cells: int = 1,
) -> ContextGraph:
    """Context graph of an image: one node per connected region of each label, at the region's centroid.

    Parameters
    ----------
    labels : int16 of shape (rows, columns)
    static : bool of shape (rows, columns)
        Other cells belong to no region.
    embeddings : float32 of shape (rows, columns, channels)
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.
    components : Components
    min_region_cells : int
        Smaller regions do not become nodes.

    Notes
    -----
    A centroid may lie outside its region (a ring, an arch) or between cells. It remains the node's position; the node's
    embedding is that of the region's cell nearest to it (ties: lowest row, then column).
    """
    rows, columns = labels.shape
    region = np.zeros(labels.shape, np.int64)
    found = 0
    for label in np.unique(labels[static]):
        parts = components((labels == label) & static)
        region = np.where(parts > 0, parts + found, region)
        found += int(parts.max())
    cells = np.flatnonzero(region)
    numbers = region.ravel()[cells] - 1
    y, x = np.divmod(cells, columns)
    sizes = np.bincount(numbers, minlength=found)
    sum_y, sum_x = (np.bincount(numbers, axis, minlength=found).astype(np.int64) for axis in (y, x))
    # Exact in integers: size^2 times the squared distance between a cell and its region's centroid.
    n = sizes[numbers]
    distance = (n * y - sum_y[numbers]) ** 2 + (n * x - sum_x[numbers]) ** 2
    nearest = _first_of_each(numbers, np.lexsort((cells, distance, numbers)), found)
    first = _first_of_each(numbers, np.lexsort((cells, numbers)), found)
    label_of = labels.ravel()[cells[first]]
    order = np.lexsort((cells[first], label_of))
    order = order[sizes[order] >= min_region_cells]
    width, height = extent
    centroids = np.stack(
        [(sum_x / np.maximum(sizes, 1) + 0.5) / columns * width, (sum_y / np.maximum(sizes, 1) + 0.5) / rows * height],
        axis=1,
    )
    flat = embeddings.reshape(-1, embeddings.shape[-1])
    return ContextGraph(
        labels=label_of[order],
        positions=centroids[order].astype(np.float32),
        embeddings=flat[cells[nearest][order]],
        shares=(sizes[order] / labels.size).astype(np.float32),
    )


def _first_of_each(numbers: npt.NDArray[np.int64], order: Indices, count: int) -> Indices:
    """For each group number 0..count-1, the first entry of `order` that belongs to it."""
    starts = np.searchsorted(numbers[order], np.arange(count))
    return order[starts]


@dataclass(frozen=True, eq=False)
class GraphComparison:
    """Comparison of one graph with several candidates.

    Parameters
    ----------
    similarity : float32 of shape (candidates,)
        S of `compare`, 0..1.
    matched : intp of shape (candidates, nodes of the query)
        For each node of the query the corresponding node of the candidate; -1 for none.
    cosines : float32 of shape (candidates, nodes of the query)
        Of the corresponding pairs; 0 elsewhere.
    edges_agreeing : int64 of shape (candidates,)
        Edges present in both graphs between matched nodes.
    """

    similarity: Floats
    matched: Indices
    cosines: Floats
    edges_agreeing: npt.NDArray[np.int64]


def compare(query: ContextGraph, candidates: Sequence[ContextGraph], cosine: float, tau: float) -> GraphComparison:
    """Similarity of context graphs, for all candidates at once.

    Nodes correspond when they carry the same label, their cosine exceeds `cosine` and each is the other's best
    (ties: lowest index). With M pairs, n_Q and n_D nodes, and adjacency A = 1 where two matched nodes lie within
    `tau`::

        J_nodes = M / (n_Q + n_D - M)
        J_edges = common edges / edges of either     (1 if M >= 2 and there are none; 0 if M < 2)
        S       = J_nodes (1 + J_edges) / 2

    so S is symmetric, 0 when nothing matches, at most 1/2 for a single pair and 1 for a graph with itself.

    Parameters
    ----------
    query : ContextGraph
    candidates : sequence of ContextGraph
    cosine : float
        Threshold t on the cosine of a pair, exclusive.
    tau : float
        Longest edge, as a fraction of the longer side.
    """
    most = max((len(c) for c in candidates), default=0)
    # With `min_region_cells=1` a graph may have thousands of nodes: memory is bounded by comparing fewer at a time.
    together = max(1, TOGETHER // max(1, len(query) * most))
    portions = [
        _compare(query, candidates[start : start + together], cosine, tau)
        for start in range(0, max(1, len(candidates)), together)
    ]
    return GraphComparison(
        similarity=np.concatenate([p.similarity for p in portions]),
        matched=np.concatenate([p.matched for p in portions]),
        cosines=np.concatenate([p.cosines for p in portions]),
        edges_agreeing=np.concatenate([p.edges_agreeing for p in portions]),
    )


def _compare(query: ContextGraph, candidates: Sequence[ContextGraph], cosine: float, tau: float) -> GraphComparison:
    n_query, count = len(query), len(candidates)
    most = max((len(c) for c in candidates), default=0)
    if n_query == 0 or most == 0:
        return GraphComparison(
            np.zeros(count, np.float32),
            np.full((count, n_query), -1, np.intp),
            np.zeros((count, n_query), np.float32),
            np.zeros(count, np.int64),
        )
    similarity, positions = _similarities(query, candidates, most)
    best_in_candidate = similarity.argmax(axis=2)  # (n_query, count)
    best_in_query = similarity.argmax(axis=0)  # (count, most)
    value = np.take_along_axis(similarity, best_in_candidate[..., None], axis=2)[..., 0]
    mutual = best_in_query[np.arange(count)[None, :], best_in_candidate] == np.arange(n_query)[:, None]
    paired = (mutual & (value > cosine)).T  # (count, n_query)
    matched = np.where(paired, best_in_candidate.T, -1)

    pairs = paired.sum(axis=1)
    common, either = _edges(query, positions, matched, tau)
    edges = np.where(either > 0, common / np.maximum(either, 1), 1.0) * (pairs >= 2)
    nodes = pairs / (n_query + np.array([len(c) for c in candidates]) - pairs)
    return GraphComparison(
        similarity=(nodes * (1 + edges) / 2).astype(np.float32),
        matched=matched,
        cosines=np.where(paired, value.T, 0).astype(np.float32),
        edges_agreeing=common.astype(np.int64),
    )


def _similarities(query: ContextGraph, candidates: Sequence[ContextGraph], most: int) -> tuple[Floats, Floats]:
    """Cosines of nodes with the same label, and positions, of candidates padded to `most` nodes.

    Returns
    -------
    float32 of shape (n_query, candidates, most)
        -inf where labels differ, and in the padding.
    float32 of shape (candidates, most, 2)
    """
    count = len(candidates)
    slot = np.arange(most)[None, :] < np.array([len(c) for c in candidates])[:, None]
    labels = np.full((count, most), -1, np.int16)
    positions = np.zeros((count, most, 2), np.float32)
    labels[slot] = np.concatenate([c.labels for c in candidates])
    positions[slot] = np.concatenate([c.positions for c in candidates])
    similarity = np.full((len(query), count, most), -np.inf, np.float32)
    similarity[:, slot] = unit(query.embeddings) @ unit(np.concatenate([c.embeddings for c in candidates])).T
    similarity[query.labels[:, None, None] != labels[None]] = -np.inf
    return similarity, positions


def _edges(query: ContextGraph, positions: Floats, matched: Indices, tau: float) -> tuple[Indices, Indices]:
    """How many edges between matched nodes both graphs have, and how many either has.

    Parameters
    ----------
    query : ContextGraph
    positions : float32 of shape (candidates, most, 2)
    matched : int of shape (candidates, n_query)
        Node of the candidate that corresponds to each node of the query; -1: none.
    tau : float

    Returns
    -------
    int of shape (candidates,), int of shape (candidates,)
    """
    paired = matched >= 0
    used = np.flatnonzero(paired.any(axis=0))  # only matched nodes can have edges
    both = np.triu(paired[:, used, None] & paired[:, None, used], k=1)
    seen = np.take_along_axis(positions, np.maximum(matched[:, used], 0)[..., None], axis=1)  # (count, used, 2)
    near_query = _distances(query.positions[None, used]) <= tau
    near_candidate = _distances(seen) <= tau
    common = (both & near_query & near_candidate).sum(axis=(1, 2))
    either = (both & (near_query | near_candidate)).sum(axis=(1, 2))
    return common, either


def _distances(points: Floats) -> Floats:
    """Euclidean distances within each set of points, (sets, n, 2) -> (sets, n, n)."""
    difference = points[:, :, None, :] - points[:, None, :, :]
    lengths: Floats = np.sqrt((difference**2).sum(axis=-1))
    return lengths
