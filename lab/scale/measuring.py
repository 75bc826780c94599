"""How often the right view is among the candidates, and first after re-ranking, in maps of growing size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lab.scale.forecast import recall_forecast
from lab.scale.pool import Placed, Pool, PoolFetch, Rows, by_channel, query_of
from schemas.description import Booleans, Floats
from schemas.recipe import MapRecipe
from schemas.records import Changes, Selection
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.search.flat_index import FlatIndex

COUNTS = (10, 25, 50)
"""Candidates of each channel."""

EVERYTHING = Selection(None, np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False)
class AtSize:
    """Results of one set in a map of one size.

    Parameters
    ----------
    views : int
    among : bool of shape (queries, counts)
        Whether a right view is among the candidates, for each of `COUNTS`.
    compared : bool of shape (queries,)
        Whether a right view is among those that are re-ranked.
    first : bool of shape (queries,)
        Whether the first answer is right.
    """

    views: int
    among: Booleans
    compared: Booleans
    first: Booleans

    @property
    def table(self) -> Booleans:
        """All of them as columns, bool (queries, counts + 2)."""
        return np.column_stack([self.among, self.compared, self.first])


def measure(placed: Placed, size: int, pool: Pool, recipe: MapRecipe, product: Product) -> AtSize:
    """Enrol the members of a map in the order of the pool, and ask it all queries.

    Parameters
    ----------
    placed : Placed
    size : int
        Views in the map.
    pool : Pool
    recipe : MapRecipe
    product : Product
    """
    seqs = np.sort(placed.members(size)).astype(np.int64) + 1
    described = recipe.description
    index = FlatIndex({name: c.length for name, c in described.parameters.channels.items()}, described.id)
    index.apply(Changes(1, described.id, seqs, pool.vectors[seqs - 1], np.zeros(0, np.int64)))
    fetch = PoolFetch(pool)
    among = np.zeros((len(placed.queries), len(COUNTS)), np.bool_)
    compared, first = np.zeros((2, len(placed.queries)), np.bool_)
    for number, (row, right) in enumerate(zip(placed.queries, placed.right, strict=True)):
        query = query_of(pool, int(row), described)
        found = index.search(query.vectors, max(*COUNTS, recipe.ranking.searched), EVERYTHING)
        correct = np.isin(found.seqs, right + 1)
        for column, count in enumerate(COUNTS):
            near = np.logical_or.reduce([(ranks > 0) & (ranks <= count) for ranks in found.ranks.values()])
            among[number, column] = (correct & near).any()
        ranked = cascade.rank(query, found, described, recipe.ranking, fetch, top=1, product=product)
        compared[number] = np.isin(ranked.seqs[: ranked.reranked], right + 1).any()
        first[number] = ranked.first[0].seq - 1 in right
    return AtSize(size, among, compared, first)


@dataclass(frozen=True, eq=False)
class Nearer:
    """How many views are nearer to each query than its best right view, by channel.

    Parameters
    ----------
    fixed, distractors : int64 of shape (channels, queries)
        Of the set's own database, and of `searched` distractors.
    searched : int
    """

    fixed: npt.NDArray[np.int64]
    distractors: npt.NDArray[np.int64]
    searched: int

    def forecast(self, views: int, own: int, counts: Sequence[int] = COUNTS) -> npt.NDArray[np.float64]:
        """Recall among candidates in a map of `views`, of which `own` are the set's; see `recall_forecast`."""
        return recall_forecast(self.fixed, self.distractors, self.searched, views - own, counts)


def nearer(placed: Placed, searched: int, pool: Pool, recipe: MapRecipe) -> Nearer:
    """Count views nearer than the best right view, among the set's own and the first `searched` distractors."""
    vectors = by_channel(pool.vectors, recipe.description)
    distractors = placed.distractors[:searched]
    own, others = [], []
    for channel in vectors.values():
        own.append(_nearer(channel, placed, placed.database))
        others.append(_nearer(channel, placed, distractors))
    return Nearer(np.stack(own), np.stack(others), len(distractors))


def _nearer(vectors: Floats, placed: Placed, rows: Rows) -> npt.NDArray[np.int64]:
    counted = np.zeros(len(placed.queries), np.int64)
    for number, (row, right) in enumerate(zip(placed.queries, placed.right, strict=True)):
        query = vectors[row]
        best = np.linalg.norm(vectors[right] - query, axis=1).min()
        wrong = rows[~np.isin(rows, right)]
        counted[number] = (np.linalg.norm(vectors[wrong] - query, axis=1) < best).sum()
    return counted
