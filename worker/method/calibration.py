"""From evidence to a probability, and from a probability to a verdict.

A score only orders candidates. A curve fitted to labelled queries (`lab.fitting`) maps features of a match (score, lead
over the next, inliers) to the probability that it is right, and two thresholds turn the probability into exactly one of
three verdicts.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]

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


@dataclass(frozen=True)
class Thresholds:
    """Probabilities that separate the three verdicts.

    Parameters
    ----------
    matched : float
        From this probability on: matched.
    ambiguous : float
        From this probability on and below `matched`: ambiguous. Below: no match.
    """

    matched: float = 0.75
    ambiguous: float = 0.4

    def __post_init__(self) -> None:
        if not 0 <= self.ambiguous <= self.matched:
            raise ValueError(f"thresholds must rise from ambiguous to matched: {self.ambiguous}, {self.matched}")

    def verdict(self, probability: float) -> Verdict:
        """The verdict for a probability; ValueError for NaN or a value outside 0..1."""
        if not 0 <= probability <= 1:
            raise ValueError(f"{probability} is no probability")
        if probability >= self.matched:
            return "matched"
        return "ambiguous" if probability >= self.ambiguous else "no_match"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A curve, the features it reads, and the thresholds of the verdict.

    Parameters
    ----------
    features : tuple of str
        Names of the columns that the curve reads, in order.
    curve : Curve
    thresholds : Thresholds
    learned_from : str
        Which labelled queries, in words; for reports.
    """

    features: tuple[str, ...]
    curve: Curve
    thresholds: Thresholds = Thresholds()
    learned_from: str = ""

    def to_json(self) -> str:
        """The calibration as JSON, kept with a map or with the weights."""
        limits = {"matched": self.thresholds.matched, "ambiguous": self.thresholds.ambiguous}
        data = {"features": list(self.features), "curve": self.curve.as_json(), "thresholds": limits}
        return json.dumps(data | {"learned_from": self.learned_from}, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Calibration":
        """Read what `to_json` wrote."""
        data = json.loads(text)
        limits = Thresholds(**data["thresholds"])
        return cls(tuple(data["features"]), curve_from_json(data["curve"]), limits, data["learned_from"])


def _sigmoid(x: Doubles) -> Doubles:
    """1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(x / 2)), np.float64)
