"""What ranks among known distractors say of larger maps."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lab.libraries import for_studies
from schemas.description import Doubles

Counts = npt.NDArray[np.int64]

START = (0.3, 30.0)
"""First guess of the two parameters of the distribution of shares."""


def fit_shares(nearer: Counts, distractors: int) -> tuple[float, float]:
    """Parameters a, b of the Beta distribution of shares under which counts out of `distractors` are likeliest."""
    with for_studies():
        from scipy.optimize import minimize  # type: ignore[import-untyped]
        from scipy.stats import betabinom  # type: ignore[import-untyped]

    def loss(logarithms: Doubles) -> float:
        a, b = np.exp(np.clip(logarithms, -7, 14))
        return -float(betabinom.logpmf(nearer, distractors, a, b).mean())

    found = minimize(loss, np.log(START), method="Nelder-Mead")
    a, b = np.exp(np.clip(found.x, -7, 14))
    return float(a), float(b)


def recall_forecast(fixed: Counts, nearer: Counts, distractors: int, among: int, counts: Sequence[int]) -> Doubles:
    """Recall of the right view among the candidates of a larger map.

    Parameters
    ----------
    fixed : int64 of shape (channels, queries)
        Views of the query's own set that are nearer than its best right view: as many in every map.
    nearer : int64 of shape (channels, queries)
        Distractors that are nearer than its best right view.
    distractors : int
        How many were searched.
    among : int
        Distractors of the larger map.
    counts : sequence of int
        Candidates of each channel.

    Returns
    -------
    float64 of shape (counts,)
        Mean over the queries.

    Notes
    -----
    A query has a share p of distractors that are nearer than its right view. In each channel the shares of all queries
    are taken to follow Beta(a, b), fitted to the counts by maximum likelihood; near 0 that is a power law. Having seen
    `nearer` of `distractors`, a query's p follows Beta(a + nearer, b + distractors - nearer), so that the number among
    `among` new distractors of the same kinds is beta-binomial. The view is lost when every channel loses it; given the
    counts, the channels are taken as independent.
    """
    with for_studies():
        from scipy.stats import betabinom
    fitted = np.array([fit_shares(counted, distractors) for counted in nearer])
    alpha, beta = nearer + fitted[:, :1], distractors - nearer + fitted[:, 1:]
    recalls = []
    for count in counts:
        room = count - 1 - fixed
        kept = np.where(room >= 0, betabinom.cdf(np.maximum(room, 0), among, alpha, beta), 0.0)
        recalls.append(float((1 - np.prod(1 - kept, axis=0)).mean()))
    return np.array(recalls)
