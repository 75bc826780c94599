"""Cached descriptions as a map of any size: members, right answers, and what a ranking reads of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lab.datasets.dataset import Dataset
from lab.scale.cache import Cache
from schemas.comparisons import KnownView
from schemas.description import Appearance, Description, Floats, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pool:
    """Histogram vectors of all cached views, and a way to read the rest of their descriptions.

    Parameters
    ----------
    cache : Cache
    keys : tuple of str
    sites : str of shape (views,)
    vectors : float32 of shape (views, dimensions)
        The channels concatenated in the recipe's order.
    """

    cache: Cache
    keys: tuple[str, ...]
    sites: npt.NDArray[np.str_]
    vectors: Floats

    @classmethod
    def of(cls, cache: Cache) -> "Pool":
        """All views of a cache that have a description, in the order in which they were described."""
        rows = cache.vectors()
        return cls(
            cache,
            tuple(key for key, _, _ in rows),
            np.array([site for _, site, _ in rows], np.str_),
            np.stack([vector for _, _, vector in rows]),
        )

    def __len__(self) -> int:
        return len(self.keys)


@dataclass(frozen=True, eq=False)
class Placed:
    """A set among the views of a pool; all numbers are rows of the pool.

    Parameters
    ----------
    name : str
    database, queries : int64 of shape (images,)
        Those that have a description.
    right : tuple of int64 of shape (right answers of the query,)
    distractors : int64 of shape (other views,)
        Views of other sites, in a fixed random order: a larger map holds all views of a smaller one.
    """

    name: str
    database: Rows
    queries: Rows
    right: tuple[Rows, ...]
    distractors: Rows

    def members(self, size: int) -> Rows:
        """The rows of a map of `size` views: the database, and distractors as far as there are any.

        Raises
        ------
        ValueError
            `size` is smaller than the database, or larger than database and distractors.
        """
        if not len(self.database) <= size <= len(self.database) + len(self.distractors):
            raise ValueError(
                f"{self.name}: {size} views; there are {len(self.database)} and {len(self.distractors)} distractors"
            )
        return np.concatenate([self.database, self.distractors[: size - len(self.database)]])


def placed(dataset: Dataset, root: Path, pool: Pool, seed: int = 0) -> Placed | None:
    """A set among the views of a pool; None when no query has a description and a right answer that has one.

    Parameters
    ----------
    dataset : Dataset
    root : Path
        The folder that the pool's keys are relative to.
    pool : Pool
    seed : int
        Decides the order of the distractors.
    """
    row = {key: number for number, key in enumerate(pool.keys)}
    database = [row.get(_key(path, root), -1) for path in dataset.database]
    queries: list[int] = []
    right: list[Rows] = []
    for path, positives in zip(dataset.queries, dataset.positives, strict=True):
        found = [database[i] for i in positives.tolist() if database[i] >= 0]
        if found and _key(path, root) in row:
            queries.append(row[_key(path, root)])
            right.append(np.array(found, np.int64))
    if not queries:
        return None
    others = np.flatnonzero(pool.sites != pool.sites[queries[0]])
    return Placed(
        dataset.name,
        np.array([i for i in database if i >= 0], np.int64),
        np.array(queries, np.int64),
        tuple(right),
        np.random.default_rng(seed).permutation(others),
    )


def _key(path: Path, root: Path) -> str:
    return str(path.relative_to(root))


class PoolFetch:
    """What a ranking reads of candidates, from a cache; implements `worker.method.cascade.Fetch`.

    Sequence numbers are rows of the pool plus one. No view has a name or a position, as in an evaluation.
    """

    def __init__(self, pool: Pool) -> None:
        self._pool = pool

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Cells at half size, graphs and extents."""
        return self._pool.cache.appearances(self._keys(seqs))

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Cells at full resolution."""
        return self._pool.cache.cells(self._keys(seqs))

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        """Local features."""
        return self._pool.cache.local_features(self._keys(seqs))

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """Nothing is known of any view."""
        return [KnownView()] * len(seqs)

    def _keys(self, seqs: Sequence[int]) -> list[str]:
        return [self._pool.keys[seq - 1] for seq in seqs]


def query_of(pool: Pool, row: int, recipe: DescriptionRecipe) -> Description:
    """The parts of a view's description that a ranking reads of a query."""
    key = [pool.keys[row]]
    seen = pool.cache.appearances(key)[0]
    return Description(
        vectors=by_channel(pool.vectors[row], recipe),
        appearance=replace(seen, coarse=seen.coarse.copy()),  # PyTorch multiplies writable arrays only
        cells=pool.cache.cells(key)[0].copy(),
        keypoints=None if recipe.parameters.local_features is None else pool.cache.local_features(key)[0],
        label_shares=np.zeros(0, np.float32),
        static_share=1.0,
        descriptor_count=0,
    )


def by_channel(vectors: Floats, recipe: DescriptionRecipe) -> Mapping[str, Floats]:
    """Cut concatenated vectors, float32 (..., dimensions), into the channels'."""
    cut, start = {}, 0
    for name, channel in recipe.parameters.channels.items():
        cut[name] = np.ascontiguousarray(vectors[..., start : start + channel.length])
        start += channel.length
    return cut
