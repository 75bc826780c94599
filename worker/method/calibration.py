"""From evidence to a probability, and from a probability to a verdict.

A score only orders candidates. A curve fitted to labelled queries (`lab.fitting`) maps features of a place to the
probability that it is right, and thresholds turn the probability into exactly one of three verdicts.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from schemas.description import Doubles

Verdict = Literal["matched", "ambiguous", "no_match"]


class Curve(Protocol):
    """Maps features to probabilities; never falls when a feature grows."""

    def probability(self, features: Doubles) -> Doubles:
        """Probability of being right, float64 (n,), for features of shape (n, features)."""
        ...

    def as_json(self) -> dict[str, Any]:
        """Plain values that `curve_from_json` reads back."""
        ...


@dataclass(frozen=True, eq=False)
class Logistic:
    """Platt's curve on several features: 1 / (1 + exp(-(bias + weights . (x - mean) / scale))).

    Parameters
    ----------
    mean, scale, weights : float64 of shape (features,)
        Weights are never negative: every feature is evidence for the match.
    bias : float
    """

    mean: Doubles
    scale: Doubles
    weights: Doubles
    bias: float

    def probability(self, features: Doubles) -> Doubles:
        """Probability of being right, float64 (n,), for features of shape (n, features)."""
        if features.ndim != 2 or features.shape[1] != len(self.weights):
            raise ValueError(f"features of shape {features.shape} for a curve over {len(self.weights)}")
        return _sigmoid((features - self.mean) / self.scale @ self.weights + self.bias)

    def as_json(self) -> dict[str, Any]:
        """Plain values that `curve_from_json` reads back."""
        return {
            "kind": "logistic",
            "mean": self.mean.tolist(),
            "scale": self.scale.tolist(),
            "weights": self.weights.tolist(),
            "bias": self.bias,
        }


@dataclass(frozen=True, eq=False)
class Isotonic:
    """Isotonic regression over one feature: linear between its knots, constant outside.

    Parameters
    ----------
    scores, values : float64 of shape (knots,)
        Both ascending.
    """

    scores: Doubles
    values: Doubles

    def probability(self, features: Doubles) -> Doubles:
        """Probability of being right, float64 (n,), for features of shape (n, 1)."""
        if features.ndim != 2 or features.shape[1] != 1:
            raise ValueError(f"an isotonic curve reads one feature, not shape {features.shape}")
        return np.asarray(np.interp(features[:, 0], self.scores, self.values), np.float64)

    def as_json(self) -> dict[str, Any]:
        """Plain values that `curve_from_json` reads back."""
        return {"kind": "isotonic", "scores": self.scores.tolist(), "values": self.values.tolist()}


def curve_from_json(data: Mapping[str, Any]) -> Curve:
    """Read a curve that `as_json` wrote; ValueError for an unknown kind."""
    if data.get("kind") == "logistic":
        mean, scale, weights = (np.asarray(data[name], np.float64) for name in ("mean", "scale", "weights"))
        return Logistic(mean, scale, weights, float(data["bias"]))
    if data.get("kind") == "isotonic":
        return Isotonic(np.asarray(data["scores"], np.float64), np.asarray(data["values"], np.float64))
    raise ValueError(f"unknown kind of calibration curve: {data.get('kind')!r}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A curve, the features it reads, and the probabilities from which an answer is `matched`.

    Parameters
    ----------
    features : tuple of str
        Names of the features that the curve reads, in order; see `worker.method.features.features`.
    curve : Curve
    precisions, thresholds : float64 of shape (n,)
        Wanted share of right answers among the matched ones, 0..1, and the lowest probability at which queries that
        the curve had not seen kept it. Both ascending, at least one.
    shares : float64 of shape (n,)
        Share of the right answers to those queries that were `matched` then.
    ambiguous : float
        Below this probability, or below the threshold if that is lower: no match.
    learned_from : str
        Which labelled queries, in words; for reports.
    """

    features: tuple[str, ...]
    curve: Curve
    precisions: Doubles
    thresholds: Doubles
    shares: Doubles
    ambiguous: float = 0.4
    learned_from: str = ""

    def __post_init__(self) -> None:
        both = self.precisions, self.thresholds
        if len({values.shape for values in both}) != 1 or any(np.any(np.diff(values) < 0) for values in both):
            raise ValueError(f"precisions and thresholds must rise together: {both}")

    def probabilities(self, read: Sequence[Mapping[str, float]]) -> list[float]:
        """Probability of being right, 0..1, for the features of each of some places."""
        columns = np.array([[one[name] for name in self.features] for one in read], np.float64)
        return [float(p) for p in np.clip(self.curve.probability(columns), 0, 1)]

    def threshold(self, precision: float) -> float:
        """Lowest probability of an answer that is `matched` at this precision.

        Linear between the known precisions. Beyond the highest one, whatever is missing to certainty shrinks in
        proportion: a threshold t for 99 of 100 means 1 - (1 - t) / 10 for 999 of 1,000.
        """
        known, last = self.precisions, float(self.thresholds[-1])
        if precision <= known[-1]:
            return float(np.interp(precision, known, self.thresholds))
        return 1 - (1 - last) * (1 - precision) / (1 - float(known[-1]))

    def share(self, precision: float) -> float:
        """Share of right answers that were `matched` at this precision."""
        return float(np.interp(precision, self.precisions, self.shares))

    def verdict(self, probability: float, precision: float) -> Verdict:
        """The verdict for a probability; ValueError for NaN or a value outside 0..1."""
        if not 0 <= probability <= 1:
            raise ValueError(f"{probability} is no probability")
        if probability >= self.threshold(precision):
            return "matched"
        return "ambiguous" if probability >= self.ambiguous else "no_match"

    def to_json(self) -> str:
        """The calibration as JSON, kept with a map or with the weights."""
        data = {
            "features": list(self.features),
            "curve": self.curve.as_json(),
            "precisions": self.precisions.tolist(),
            "thresholds": self.thresholds.tolist(),
            "shares": self.shares.tolist(),
            "ambiguous": self.ambiguous,
            "learned_from": self.learned_from,
        }
        return json.dumps(data, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Calibration":
        """Read what `to_json` wrote."""
        data = json.loads(text)
        return cls(
            features=tuple(data["features"]),
            curve=curve_from_json(data["curve"]),
            **{name: np.asarray(data[name], np.float64) for name in ("precisions", "thresholds", "shares")},
            ambiguous=float(data["ambiguous"]),
            learned_from=data["learned_from"],
        )


def _sigmoid(x: Doubles) -> Doubles:
    """1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(x / 2)), np.float64)
