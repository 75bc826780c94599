"""From evidence to an order: a weighted sum of named terms; ties go to the earlier enrolled."""

from collections.abc import Mapping

import numpy as np

from schemas.description import Floats, Indices
from schemas.recipe import Channel, RankingConfig


def histogram_similarity(distances: Floats, channel: Channel) -> Floats:
    """Similarity of histogram vectors, from their distance.

    Parameters
    ----------
    distances : float32 of shape (n,)
        Euclidean.
    channel : Channel
        Hellinger and projected vectors have unit length, so the cosine is 1 - d^2 / 2. Plain frequencies lie at most
        sqrt(2) apart.

    Returns
    -------
    float32 of shape (n,)
        0..1.
    """
    unit_length = channel.normalisation == "hellinger" or channel.dimensions is not None
    alike = 1 - distances**2 / 2 if unit_length else 1 - distances / np.sqrt(2)
    return np.clip(alike, 0, 1).astype(np.float32)


def weigh(terms: Mapping[str, Floats], weights: Mapping[str, float]) -> tuple[Floats, dict[str, Floats]]:
    """Add up weighted terms.

    Parameters
    ----------
    terms : mapping of term to float32 of shape (n,)
        0..1 each; a missing term counts as 0.
    weights : mapping of term to float
        At least 0; divided by their sum, so that the score stays in 0..1.

    Returns
    -------
    score : float32 of shape (n,)
    parts : mapping of term to float32 of shape (n,)
        Sum to the score.
    """
    total = sum(weights.values())
    parts = {name: terms[name] * np.float32(weight / total) for name, weight in weights.items() if name in terms}
    nothing = np.zeros(len(next(iter(terms.values()))), np.float32)
    # Rounding may leave a sum of weights, and so a score, just above 1.
    return np.minimum(sum(parts.values(), start=nothing), 1), parts


def score(terms: Mapping[str, Floats], config: RankingConfig, reranked: Indices) -> tuple[Floats, dict[str, Floats]]:
    """Score of every candidate, and its weighted terms.

    With ``mode="graph"`` (the paper) the graph similarity is the score, and the histogram only breaks ties; with
    nothing re-ranked the histograms are the score, by their weights, or all alike where none has any. A candidate that
    was not re-ranked never scores above one that was.

    Parameters
    ----------
    terms : mapping of term to float32 of shape (n,)
    config : RankingConfig
    reranked : intp of shape (m,)

    Returns
    -------
    As `weigh`.
    """
    weights = config.weights.terms()
    if len(reranked) == 0:
        weights = {name: weights.get(name, 0.0) for name in terms}
        weights = weights if any(weights.values()) else dict.fromkeys(terms, 1.0)
    elif config.mode == "graph":
        weights = {"graph": 1.0}
    total, parts = weigh(terms, weights)
    others = np.setdiff1d(np.arange(len(total)), reranked)
    if len(reranked) and len(others):
        ceiling = float(total[reranked].min())
        scale = np.ones(len(total), np.float32)
        scale[others] = np.minimum(1, ceiling / np.maximum(total[others], 1e-9))
        total = total * scale
        total[others] = np.minimum(total[others], ceiling)  # rounding may leave a product just above it
        parts = {name: part * scale for name, part in parts.items()}
    return total, parts


def order(total: Floats, distance: Floats, reranked: Indices) -> Indices:
    """Best first: re-ranked candidates by score, then histogram distance, then enrolment; the others follow.

    Parameters
    ----------
    total, distance : float32 of shape (n,)
        Candidates in enrolment order.
    reranked : intp of shape (m,)

    Returns
    -------
    intp of shape (n,)
    """
    behind = np.ones(len(total), np.bool_)
    behind[reranked] = False
    rows: Indices = np.lexsort((np.arange(len(total)), distance, -total, behind))
    return rows
