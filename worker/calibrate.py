"""Learn how sure an answer is from labelled queries, and judge that on sets it was not learned from.

``python -m worker.calibrate pairs --root DIR --write FILE`` or ``./revisit evaluate --calibrate``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from worker.datasets.dataset import Dataset
from worker.evaluation.asking import Asked
from worker.place.calibration import (
    Calibration,
    Curve,
    Judgement,
    Logistic,
    Thresholds,
    fit_logistic,
    judge,
    leave_one_out,
    threshold_for_precision,
)
from worker.place.recall import Booleans, Doubles, first_right

MATCHED_PRECISION = 0.95
"""How often ``matched`` has to be right on the sets that the thresholds are learned from."""

AMBIGUOUS = 0.4
"""Probability below which an answer is no match, unless ``matched`` begins lower."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was seen of the first answers to one set's queries, and whether they were right.

    Parameters
    ----------
    features : mapping of name to float64 of shape (queries,)
    right : bool of shape (queries,)
    """

    features: Mapping[str, Doubles]
    right: Booleans

    def columns(self, names: Sequence[str]) -> Doubles:
        """Some features side by side, float64 (queries, names); a feature never seen is 0."""
        nothing = np.zeros(len(self.right))
        return np.stack([self.features.get(name, nothing) for name in names], axis=1)


def evidence(dataset: Dataset, asked: Asked) -> Evidence:
    """The evidence in a run's answers; queries without any answer are left out, since their verdict needs no curve."""
    answered = asked.ranked[:, 0] >= 0
    right = first_right(asked.ranked, dataset.judged()) == 1
    return Evidence({name: values[answered] for name, values in asked.features.items()}, right[answered])


@dataclass(frozen=True, eq=False)
class Learned:
    """A calibration and how it did.

    Parameters
    ----------
    calibration : Calibration
        Learned from all sets.
    by_set : mapping of set to Judgement
        Of a curve learned from all other sets.
    together : Judgement
        All left-out probabilities pooled.
    constant : Judgement
        The same for a curve that knows only how often answers are right elsewhere: what knowing nothing costs.
    """

    calibration: Calibration
    by_set: Mapping[str, Judgement]
    together: Judgement
    constant: Judgement


def learn(sets: Mapping[str, Evidence], names: Sequence[str], source: str, penalty: float = 1.0) -> Learned:
    """Learn a logistic curve over some features and its thresholds.

    Parameters
    ----------
    sets : mapping of name to Evidence
        At least two.
    names : sequence of str
        Features that the curve reads.
    source : str
        For the record.
    penalty : float

    Raises
    ------
    ValueError
        Too few sets, or all answers right or all wrong.
    """
    rows = {name: (found.columns(names), found.right) for name, found in sets.items()}

    def fit(features: Doubles, right: Booleans) -> Curve:
        return fit_logistic(features, right, penalty=penalty)

    def guess(features: Doubles, right: Booleans) -> Curve:
        share = float(np.clip(right.mean(), 1e-3, 1 - 1e-3))
        zeros = np.zeros(features.shape[1])
        return Logistic(zeros, zeros + 1, zeros, float(np.log(share / (1 - share))))

    by_set, together = leave_one_out(rows, fit)
    _, constant = leave_one_out(rows, guess)
    features = np.concatenate([f for f, _ in rows.values()])
    right = np.concatenate([r for _, r in rows.values()])
    curve = fit(features, right)
    # Thresholds from probabilities that were left out: the curve's own are surer than they should be.
    unseen = np.concatenate(
        [
            fit(
                np.concatenate([f for other, (f, _) in rows.items() if other != name]),
                np.concatenate([r for other, (_, r) in rows.items() if other != name]),
            ).probability(rows[name][0])
            for name in rows
        ]
    )
    matched = min(threshold_for_precision(unseen, right, MATCHED_PRECISION), 1.0)
    limits = Thresholds(matched=matched, ambiguous=min(AMBIGUOUS, matched))
    return Learned(Calibration(tuple(names), curve, limits, source), by_set, together, constant)


def as_markdown(learned: Learned) -> str:
    """How the calibration did on each set that it was not learned from."""
    lines = ["| set | queries | expected calibration error | Brier | log loss |", "| --- | --- | --- | --- | --- |"]
    rows = [*learned.by_set.items(), ("*all, pooled*", learned.together), ("*without evidence*", learned.constant)]
    for name, j in rows:
        lines.append(f"| {name} | {j.queries} | {j.expected_error:.3f} | {j.brier:.3f} | {j.log_loss:.3f} |")
    return "\n".join(lines)


def judged_on(calibration: Calibration, sets: Mapping[str, Evidence]) -> dict[str, Judgement]:
    """How a calibration does on sets it may or may not have been learned from."""
    found = {}
    for name, seen in sets.items():
        found[name] = judge(calibration.curve.probability(seen.columns(calibration.features)), seen.right)
    return found
