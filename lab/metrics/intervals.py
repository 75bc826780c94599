"""How sure a share or an area is, when neighbouring queries say nearly the same."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lab.libraries import for_studies
from lab.metrics.recall import Indices
from schemas.description import Booleans

Names = npt.NDArray[np.str_]

LEVEL = 0.95
"""Of every interval."""

RESAMPLES = 2000


@dataclass(frozen=True)
class Share:
    """How many of some queries something happened to.

    Parameters
    ----------
    events, queries : int
    low, high : float
        95 % interval from drawing blocks of queries again; where nothing or everything happened, the exact binomial
        bound for as many trials as there are blocks. Of a single block, the exact interval below. NaN without queries.
    exact_low, exact_high : float
        95 % interval of Clopper and Pearson, as if all queries were independent of each other.
    """

    events: int
    queries: int
    low: float
    high: float
    exact_low: float
    exact_high: float

    @property
    def value(self) -> float:
        """The share; NaN without queries."""
        return self.events / self.queries if self.queries else float("nan")


def exact_interval(events: int, trials: int, level: float = LEVEL) -> tuple[float, float]:
    """Binomial interval of Clopper and Pearson (1934).

    Parameters
    ----------
    events, trials : int
        0 of 2,390 gives (0, 0.00154): having seen nothing is no proof that nothing ever happens.
    level : float
        Two-sided.

    Returns
    -------
    (low, high) : float
        NaN without trials.
    """
    if trials == 0:
        return float("nan"), float("nan")
    with for_studies():
        from scipy.stats import binomtest  # type: ignore[import-untyped]
    found = binomtest(events, trials).proportion_ci(confidence_level=level, method="exact")
    return float(found.low), float(found.high)


def share(
    happened: Booleans, among: Booleans, blocks: Names, generator: np.random.Generator, level: float = LEVEL
) -> Share:
    """A share with its intervals.

    Parameters
    ----------
    happened, among : bool of shape (queries,)
        The share is that of `happened` among `among`: both are drawn again, since how many queries are, say,
        ``matched`` is as uncertain as how many of those are right.
    blocks : str of shape (queries,)
        Queries of the same block are drawn together: a drive, or a stretch of neighbouring queries.
    generator : numpy.random.Generator
    level : float

    Returns
    -------
    Share
    """
    events, queries = int((happened & among).sum()), int(among.sum())
    exact = exact_interval(events, queries, level)
    if events in (0, queries):
        trials = len(np.unique(blocks[among]))
        low, high = exact_interval(trials if events else 0, trials, level)
        return Share(events, queries, low, high, *exact)
    if len(np.unique(blocks)) == 1:  # drawn again, it is always itself
        return Share(events, queries, *exact, *exact)
    # Of all blocks, so that the number of queries among `among` varies as it would.
    everything, whole = np.unique(blocks, return_inverse=True)
    top = np.bincount(whole, weights=happened & among, minlength=len(everything))
    below = np.bincount(whole, weights=among, minlength=len(everything))
    drawn = generator.integers(0, len(everything), size=(RESAMPLES, len(everything)))
    count = below[drawn].sum(axis=1)
    ratios = top[drawn].sum(axis=1)[count > 0] / count[count > 0]
    low, high = np.quantile(ratios, [(1 - level) / 2, (1 + level) / 2])
    return Share(events, queries, float(low), float(high), *exact)


def block_bootstrap(
    blocks: Names,
    statistic: Callable[[Indices], float],
    generator: np.random.Generator,
    *,
    resamples: int = 500,
    level: float = LEVEL,
) -> tuple[float, float]:
    """Percentile interval of any statistic from drawing blocks of queries again.

    Parameters
    ----------
    blocks : str of shape (queries,)
    statistic : function
        From indices of queries, some of them repeated, to a number; draws for which it is NaN are left out.
    generator : numpy.random.Generator
    resamples : int
    level : float

    Returns
    -------
    (low, high) : float
        NaN when there are no queries, or only those of one block: drawn again, it is always itself.
    """
    names, block = np.unique(blocks, return_inverse=True)
    if len(names) < 2:
        return float("nan"), float("nan")
    order = np.argsort(block, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(block))[:-1])
    drawn = generator.integers(0, len(names), size=(resamples, len(names)))
    values = np.array([statistic(np.concatenate([members[i] for i in row])) for row in drawn])
    values = values[~np.isnan(values)]
    if len(values) == 0:
        return float("nan"), float("nan")
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
