"""Knowing a place from not knowing it: precision and recall of the claim "I have been here".

A query is *claimed* when its confidence reaches a threshold. A claim is right when the first answer shows the
place. Recall counts right claims among the answerable queries; precision, right claims among all claims, those
of places that were never enrolled included.
"""

from dataclasses import dataclass

import numpy as np

from schemas.description import Booleans, Doubles


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """The curve over all thresholds, from the most confident claim to claiming everything.

    Parameters
    ----------
    thresholds, precision, recall : float64 of shape (distinct confidences,)
        Thresholds descending. Queries of equal confidence are claimed together: a scorer that gives all the same
        score has one point, not a lucky order.
    """

    thresholds: Doubles
    precision: Doubles
    recall: Doubles

    @property
    def f1(self) -> Doubles:
        """Harmonic mean of precision and recall at each threshold, float64."""
        total = self.precision + self.recall
        return np.divide(2 * self.precision * self.recall, total, out=np.zeros_like(total), where=total > 0)

    @property
    def best_f1(self) -> tuple[float, float]:
        """(F1, threshold) at the best threshold; (0, inf) when there is none."""
        if len(self.thresholds) == 0:
            return 0.0, float("inf")
        best = int(np.argmax(self.f1))
        return float(self.f1[best]), float(self.thresholds[best])

    @property
    def recall_at_full_precision(self) -> float:
        """The largest recall without one wrong claim: what a robot that must not err can use."""
        return float(self.recall[self.precision == 1.0].max(initial=0.0))

    @property
    def average_precision(self) -> float:
        """Area under the curve, as the sum of precision times the step in recall (no interpolation)."""
        steps = np.diff(self.recall, prepend=0.0)
        return float(np.sum(self.precision * steps))


def precision_recall(confidence: Doubles, right: Booleans, answerable: Booleans) -> PrecisionRecall:
    """Precision and recall of claiming every query whose confidence reaches a threshold.

    Parameters
    ----------
    confidence : float64 of shape (queries,)
        Of the first answer, or any score that grows with it.
    right : bool of shape (queries,)
        Whether the first answer shows the query's place.
    answerable : bool of shape (queries,)

    Returns
    -------
    PrecisionRecall

    Raises
    ------
    ValueError
        When a confidence is not a number, or an unanswerable query counts as right.
    """
    if np.isnan(confidence).any():
        raise ValueError("every query needs a confidence; NaN cannot be ordered")
    if np.any(right & ~answerable):
        raise ValueError("a query without a right answer cannot have been answered rightly")
    order = np.argsort(-confidence, kind="stable")
    falling = confidence[order]
    last_of_ties = np.flatnonzero(np.append(falling[1:] != falling[:-1], True)) if len(falling) else np.array([], int)
    right_claims = np.cumsum(right[order])[last_of_ties]
    claims = last_of_ties + 1
    possible = max(int(answerable.sum()), 1)
    return PrecisionRecall(falling[last_of_ties], right_claims / claims, right_claims / possible)


def correct_rejection(claimed: Booleans, answerable: Booleans) -> float:
    """Share of unanswerable queries that were not claimed; NaN when every query is answerable."""
    unknown = ~answerable
    return float(np.mean(~claimed[unknown])) if unknown.any() else float("nan")
