"""How often the right place is among the first answers, and whether that is more than luck.

Every figure here comes with two others: what a random order gets (`chance`) and what a perfect one gets
(`ceiling`). The paper's KITTI row equals the first and exceeds the second of a sane protocol, unnoticed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Doubles

Indices = npt.NDArray[np.int64]

DEPTHS = (1, 5, 10, 20)
"""The N of recall@N that the paper reports."""

FEWEST_BLOCKS = 3
"""Runs of neighbours that an interval is drawn from, at least: a single one, drawn again, is always itself."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Which answers are right.

    Parameters
    ----------
    positives : tuple of int64 of shape (right answers of the query,)
        Database indices that show the query's place; empty when the place is not in the database.
    searched : int64 of shape (queries,)
        How many database images each query is searched among: those with a smaller index. The whole database
        except in online loop closure, where a frame knows only what came well before it.
    ignored : int64 of shape (queries,) or None
        How many of those are neither right nor wrong, and left out of rankings.
    """

    positives: tuple[Indices, ...]
    searched: Indices
    ignored: Indices | None = None

    def __post_init__(self) -> None:
        if self.searched.shape != (len(self.positives),):
            raise ValueError(f"{len(self.positives)} queries, but {self.searched.shape} sizes of the database")
        for query, (right, size) in enumerate(zip(self.positives, self.searched, strict=True)):
            if len(np.unique(right)) != len(right) or (len(right) and (right.min() < 0 or right.max() >= size)):
                raise ValueError(f"query {query}: right answers must be distinct and in 0..{size - 1}, not {right}")

    @classmethod
    def of(cls, positives: Sequence[Sequence[int] | Indices], searched: int | Indices) -> "Truth":
        """Truth from plain lists; one number means that every query is searched among that many images."""
        sizes = np.broadcast_to(np.asarray(searched, np.int64), (len(positives),))
        return cls(tuple(np.asarray(p, np.int64) for p in positives), np.array(sizes))

    def __len__(self) -> int:
        return len(self.positives)

    @property
    def judged(self) -> Indices:
        """How many database images can be right or wrong for each query, int64 (queries,)."""
        return self.searched if self.ignored is None else self.searched - self.ignored

    @property
    def counts(self) -> Indices:
        """Right answers of each query, int64 (queries,)."""
        return np.array([len(p) for p in self.positives], np.int64)

    @property
    def answerable(self) -> Booleans:
        """Whether the database shows the query's place at all, bool (queries,)."""
        return self.counts > 0


def first_right(ranked: Indices, truth: Truth) -> Indices:
    """Rank, from 1, of each query's first right answer; 0 when none was right.

    Parameters
    ----------
    ranked : int64 of shape (queries, depth)
        Database indices, best first; -1 where there was no further answer.
    truth : Truth

    Returns
    -------
    int64 of shape (queries,)

    Raises
    ------
    ValueError
        When a query got an answer from outside the database it was searched among: such a retriever has seen
        what it must not have seen.
    """
    if len(ranked) != len(truth):
        raise ValueError(f"{len(ranked)} rankings for {len(truth)} queries")
    if np.any(ranked >= truth.searched[:, None]):
        raise ValueError("an answer lies outside the database that its query was searched among")
    first = np.zeros(len(ranked), np.int64)
    for query, right in enumerate(truth.positives):
        hits = np.flatnonzero(np.isin(ranked[query], right))
        if len(hits):
            first[query] = hits[0] + 1
    return first


def found_within(first: Indices, depths: Sequence[int] = DEPTHS) -> Booleans:
    """Whether each query was found among the first N answers, bool (queries, depths)."""
    return (first[:, None] > 0) & (first[:, None] <= np.asarray(depths))


def recall(first: Indices, mask: Booleans | None = None, depths: Sequence[int] = DEPTHS) -> Doubles:
    """recall@N over the queries of `mask` (None: all), float64 (depths,); NaN when there are none."""
    chosen = first if mask is None else first[mask]
    if len(chosen) == 0:
        return np.full(len(depths), np.nan)
    return np.asarray(found_within(chosen, depths).mean(axis=0), np.float64)


def chance_of_each(truth: Truth, depths: Sequence[int] = DEPTHS) -> Doubles:
    """Probability that a uniformly random order finds each query, float64 (queries, depths).

    Notes
    -----
    Hypergeometric: with r right answers among n, the first N miss all of them with probability
    C(n - r, N) / C(n, N) = product over i < N of (n - r - i) / (n - i).
    """
    n, r = truth.judged.astype(np.float64), truth.counts.astype(np.float64)
    out = np.zeros((len(truth), len(depths)))
    missed = np.ones(len(truth))
    for i in range(max(depths, default=0)):
        # Once n - r - i reaches 0 every further draw is a right one, and the product stays 0.
        missed = missed * np.clip(n - r - i, 0, None) / np.maximum(n - i, 1)
        for column, depth in enumerate(depths):
            if depth == i + 1:
                out[:, column] = np.where(r > 0, 1 - missed, 0.0)
    return out


def chance(truth: Truth, mask: Booleans | None = None, depths: Sequence[int] = DEPTHS) -> Doubles:
    """Expected recall@N of a random order over the queries of `mask` (None: all), float64 (depths,)."""
    each = chance_of_each(truth, depths) if mask is None else chance_of_each(truth, depths)[mask]
    return np.asarray(each.mean(axis=0), np.float64) if len(each) else np.full(len(depths), np.nan)


def ceiling(truth: Truth, mask: Booleans | None = None) -> float:
    """Recall@N of a perfect order over the queries of `mask` (None: all): the answerable share, at every N."""
    answerable = truth.answerable if mask is None else truth.answerable[mask]
    return float(answerable.mean()) if len(answerable) else float("nan")


def bootstrap_interval(
    values: npt.NDArray[np.generic],
    generator: np.random.Generator,
    *,
    block: int = 1,
    resamples: int = 2000,
    level: float = 0.95,
) -> tuple[Doubles, Doubles]:
    """Percentile bootstrap interval of the mean over queries.

    Parameters
    ----------
    values : of shape (queries, columns)
        For recall the found-or-not of `found_within`; for a comparison of two methods on the same queries the
        difference of theirs, so that what is hard for both cancels.
    generator : numpy.random.Generator
    block : int
        Queries drawn together. Frames of one drive resemble their neighbours, so that 200 of them say less than
        200 independent ones; drawing runs of neighbours (circular moving blocks) keeps the interval honest. Runs are
        shorter where there would be fewer than `FEWEST_BLOCKS`.
    resamples : int
    level : float

    Returns
    -------
    (low, high) : float64 of shape (columns,) each; NaN when there are no queries.
    """
    data = np.asarray(values, np.float64)
    n = len(data)
    if n == 0:
        nothing = np.full(data.shape[1], np.nan)
        return nothing, nothing
    block = _shortened(block, n)
    starts = generator.integers(0, n, size=(resamples, -(-n // block)))
    means = np.empty((resamples, data.shape[1]))
    for i, start in enumerate(starts):
        drawn = ((start[:, None] + np.arange(block)) % n).ravel()[:n]
        means[i] = data[drawn].mean(axis=0)
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return low, high


def _shortened(block: int, queries: int) -> int:
    return max(1, min(block, queries // FEWEST_BLOCKS))


def share_interval(
    found: Booleans, generator: np.random.Generator, *, block: int = 1, level: float = 0.95
) -> tuple[Doubles, Doubles]:
    """Interval of a share: the bootstrap's, except where none or all were found.

    Parameters
    ----------
    found : bool of shape (queries, columns)
    generator, block, level
        As `bootstrap_interval`.

    Returns
    -------
    (low, high) : float64 of shape (columns,) each

    Notes
    -----
    Drawing again from nothing but failures gives nothing but failures, as if 0 of 5 were certainty. There the exact
    binomial bound is taken, 1 - ((1 - level) / 2)^(1 / n), n being the number of blocks.
    """
    low, high = bootstrap_interval(found, generator, block=block, level=level)
    if len(found) == 0:
        return low, high
    bound = ((1 - level) / 2) ** (_shortened(block, len(found)) / len(found))
    high = np.where(found.any(axis=0), high, 1 - bound)
    return np.where(found.all(axis=0), bound, low), high
