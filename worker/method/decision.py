"""Calibrated confidence of each match, and one verdict for every answer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from worker.method.calibration import Calibration, Logistic, Thresholds, Verdict
from worker.method.cascade import RankedCandidate

UNCALIBRATED = Calibration(
    ("score",),
    Logistic(np.array([0.5]), np.array([0.1]), np.array([1.0]), 0.0),
    Thresholds(),
    "nothing: a plain curve through a score of one half, for encoders without labelled queries",
)

ALONE = 0.2
"""Score that stands in for a second match where there is only one: about that of the best of a few wrong views."""


@dataclass(frozen=True)
class Decision:
    """The verdict on an answer.

    Parameters
    ----------
    status : {"matched", "ambiguous", "no_match"}
    confidence : float
        Of the first match; 0 without a match.
    confidences : tuple of float
        Of each match, never rising with rank.
    """

    status: Verdict
    confidence: float
    confidences: tuple[float, ...]


def features(found: Sequence[RankedCandidate]) -> Mapping[str, npt.NDArray[np.float64]]:
    """Features of each match that a calibration may read, float64 (matches,) each.

    ``score``; ``lead``, score minus that of the best other match (for all but the first, minus that of the first: 0 or
    less); ``standing`` and ``margin``, dense similarity minus its median and minus its 85th percentile over the
    candidates; ``inliers``, log(1 + inliers) of verification; and ``part.TERM``, each weighted term of the score.
    """
    scores = np.array([f.score for f in found], np.float64)
    best, second = [*np.sort(scores)[::-1].tolist(), ALONE][:2]
    read = {
        "score": scores,
        "lead": np.where(scores == best, best - second, scores - best),
        "standing": np.array(
            [0.0 if f.dense is None else f.dense.similarity - f.dense.median_similarity for f in found]
        ),
        "margin": np.array([0.0 if f.dense is None else f.dense.similarity - f.dense.p85_similarity for f in found]),
        "inliers": np.log1p([0 if f.verified is None else f.verified.inliers for f in found]),
    }
    for term in sorted({term for f in found for term in f.parts}):
        read[f"part.{term}"] = np.array([f.parts.get(term, 0.0) for f in found], np.float64)
    return read


def decide(found: Sequence[RankedCandidate], calibration: Calibration) -> Decision:
    """Confidence of each match and the verdict on the answer.

    Parameters
    ----------
    found : sequence of RankedCandidate
        Best first.
    calibration : Calibration
    """
    if not found:
        return Decision("no_match", 0.0, ())
    read = features(found)
    nothing = np.zeros(len(found))
    columns = np.stack([read.get(name, nothing) for name in calibration.features], axis=1)
    probabilities = np.minimum.accumulate(np.clip(calibration.curve.probability(columns), 0, 1))
    first = float(probabilities[0])
    return Decision(calibration.thresholds.verdict(first), first, tuple(float(p) for p in probabilities))
