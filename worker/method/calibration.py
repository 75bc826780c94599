"""From scores to probabilities, and from a probability to a verdict.

A score orders candidates; a user needs to know how often an answer like this one is right. A curve learned from
labelled queries turns what the ranking saw (score, lead over the next place, inliers) into that probability, and
two thresholds turn the probability into exactly one of three verdicts.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from lab.metrics.recall import Booleans, Doubles, Indices

Verdict = Literal["matched", "ambiguous", "no_match"]


class Curve(Protocol):
    """Anything that turns features into probabilities, never falling when a feature grows."""

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
    """The best curve that never falls, over one feature; straight between its knots, level outside.

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
    """The curve that `as_json` wrote; ValueError for an unknown kind."""
    if data.get("kind") == "logistic":
        mean, scale, weights = (np.asarray(data[name], np.float64) for name in ("mean", "scale", "weights"))
        return Logistic(mean, scale, weights, float(data["bias"]))
    if data.get("kind") == "isotonic":
        return Isotonic(np.asarray(data["scores"], np.float64), np.asarray(data["values"], np.float64))
    raise ValueError(f"unknown kind of calibration curve: {data.get('kind')!r}")


@dataclass(frozen=True)
class Thresholds:
    """Where one verdict ends and the next begins, as probabilities.

    Parameters
    ----------
    matched : float
        At least this: matched.
    ambiguous : float
        At least this, but less than `matched`: ambiguous. Below: no match.
    """

    matched: float = 0.75
    ambiguous: float = 0.4

    def __post_init__(self) -> None:
        if not 0 <= self.ambiguous <= self.matched:
            raise ValueError(f"thresholds must rise from ambiguous to matched: {self.ambiguous}, {self.matched}")

    def verdict(self, probability: float) -> Verdict:
        """The one verdict of a probability; ValueError when it is none (NaN, or outside 0..1)."""
        if not 0 <= probability <= 1:
            raise ValueError(f"{probability} is no probability")
        if probability >= self.matched:
            return "matched"
        return "ambiguous" if probability >= self.ambiguous else "no_match"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A curve, what it reads, and the thresholds: all that turns a ranking into a decision.

    Parameters
    ----------
    features : tuple of str
        Names of the columns that the curve reads, in order.
    curve : Curve
    thresholds : Thresholds
    learned_from : str
        Which queries; for the report and for whoever wonders years later.
    """

    features: tuple[str, ...]
    curve: Curve
    thresholds: Thresholds = Thresholds()
    learned_from: str = ""

    def to_json(self) -> str:
        """A small JSON text, kept with a map or with the weights."""
        limits = {"matched": self.thresholds.matched, "ambiguous": self.thresholds.ambiguous}
        data = {"features": list(self.features), "curve": self.curve.as_json(), "thresholds": limits}
        return json.dumps(data | {"learned_from": self.learned_from}, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Calibration":
        """What `to_json` wrote."""
        data = json.loads(text)
        limits = Thresholds(**data["thresholds"])
        return cls(tuple(data["features"]), curve_from_json(data["curve"]), limits, data["learned_from"])


def fit_logistic(features: Doubles, right: Booleans, *, penalty: float = 1.0) -> Logistic:
    """Fit a logistic curve by Newton's method with an L2 penalty, keeping every weight at 0 or above.

    Parameters
    ----------
    features : float64 of shape (n, features)
        Each should grow with the evidence for a match.
    right : bool of shape (n,)
    penalty : float
        On the squared weights of standardised features; the bias is free. Without it, perfectly separated
        queries would give an infinitely steep curve.

    Returns
    -------
    Logistic

    Raises
    ------
    ValueError
        When the queries are all right or all wrong: nothing can be learned from them.
    """
    _check(features, right)
    mean, scale = features.mean(axis=0), features.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    standard = (features - mean) / scale
    kept = np.arange(features.shape[1])
    # A negative weight would make a better score less credible. The feature that contradicts most is left out
    # and the rest refitted, until none contradicts.
    while True:
        solution = _newton(standard[:, kept], right, penalty)
        if len(kept) == 0 or solution[:-1].min() >= 0:
            break
        kept = np.delete(kept, int(solution[:-1].argmin()))
    weights = np.zeros(features.shape[1])
    weights[kept] = solution[:-1]
    return Logistic(mean, scale, weights, float(solution[-1]))


def fit_isotonic(scores: Doubles, right: Booleans) -> Isotonic:
    """Fit the never-falling curve nearest to the outcomes (pool adjacent violators).

    Parameters
    ----------
    scores : float64 of shape (n,)
    right : bool of shape (n,)

    Returns
    -------
    Isotonic
        With a knot at the mean score of each pooled block. Values keep away from 0 and 1 by half a query in
        n + 1: a hundred right answers do not prove certainty.

    Raises
    ------
    ValueError
        As `fit_logistic`.
    """
    _check(scores[:, None], right)
    names, group = np.unique(scores, return_inverse=True)
    count = np.bincount(group).astype(np.float64)
    wins = np.bincount(group, weights=right)
    blocks: list[tuple[float, float, float]] = []  # (queries, right ones, sum of scores)
    for n, w, s in zip(count, wins, names * count, strict=True):
        block = (float(n), float(w), float(s))
        while blocks and blocks[-1][1] * block[0] >= block[1] * blocks[-1][0]:
            last = blocks.pop()
            block = (last[0] + block[0], last[1] + block[1], last[2] + block[2])
        blocks.append(block)
    edge = 0.5 / (len(scores) + 1)
    knots = np.array([s / n for n, _, s in blocks])
    return Isotonic(knots, np.clip([w / n for n, w, _ in blocks], edge, 1 - edge))


def threshold_for_precision(probability: Doubles, right: Booleans, precision: float) -> float:
    """The lowest threshold whose claims are right at least this often; inf when there is none.

    Parameters
    ----------
    probability : float64 of shape (n,)
    right : bool of shape (n,)
    precision : float
    """
    order = np.argsort(-probability, kind="stable")
    falling = probability[order]
    share = np.cumsum(right[order]) / np.arange(1, len(order) + 1)
    complete = np.append(falling[1:] != falling[:-1], True)  # equal probabilities are claimed together
    good = falling[complete & (share >= precision)]
    return float(good[-1]) if len(good) else float("inf")


@dataclass(frozen=True, eq=False)
class Reliability:
    """What was promised against what came true, per bin of probability.

    Parameters
    ----------
    edges : float64 of shape (bins + 1,)
    counts : int64 of shape (bins,)
    promised, true : float64 of shape (bins,)
        Mean probability and share of right answers; NaN in empty bins.
    """

    edges: Doubles
    counts: Indices
    promised: Doubles
    true: Doubles

    @property
    def expected_error(self) -> float:
        """Expected calibration error: mean of |promised - true|, weighted by the queries of each bin."""
        filled = self.counts > 0
        gaps = np.abs(self.promised[filled] - self.true[filled])
        return float(np.average(gaps, weights=self.counts[filled])) if filled.any() else float("nan")


def reliability(probability: Doubles, right: Booleans, bins: int = 10) -> Reliability:
    """Sort queries into equally wide bins of probability (the last includes 1)."""
    where = np.minimum((probability * bins).astype(np.int64), bins - 1)
    counts = np.bincount(where, minlength=bins)
    with np.errstate(invalid="ignore"):
        promised = np.bincount(where, weights=probability, minlength=bins) / counts
        true = np.bincount(where, weights=right, minlength=bins) / counts
    return Reliability(np.linspace(0, 1, bins + 1), counts, promised, true)


@dataclass(frozen=True)
class Judgement:
    """How a curve did on queries it was not learned from."""

    queries: int
    expected_error: float
    brier: float
    log_loss: float


def judge(probability: Doubles, right: Booleans) -> Judgement:
    """Expected calibration error, Brier score and mean log loss (natural) of probabilities."""
    safe = np.clip(probability, 1e-12, 1 - 1e-12)
    loss = -np.mean(np.where(right, np.log(safe), np.log1p(-safe)))
    brier = float(np.mean((probability - right) ** 2))
    return Judgement(len(right), reliability(probability, right).expected_error, brier, float(loss))


def leave_one_out(
    sets: Mapping[str, tuple[Doubles, Booleans]], fit: Callable[[Doubles, Booleans], Curve]
) -> tuple[dict[str, Judgement], Judgement]:
    """Judge a way of fitting: for each set, learn from all others.

    Parameters
    ----------
    sets : mapping of name to (features, right)
        float64 (n, features) and bool (n,).
    fit : function
        From features and outcomes to a curve.

    Returns
    -------
    (by_set, together) : dict of str to Judgement, and Judgement
        `together` pools the left-out probabilities of all sets.
    """
    if len(sets) < 2:
        raise ValueError("leaving one set out needs at least two")
    left_out: list[tuple[Doubles, Booleans]] = []
    by_set = {}
    for name, (features, right) in sets.items():
        others: Sequence[tuple[Doubles, Booleans]] = [pair for other, pair in sets.items() if other != name]
        curve = fit(np.concatenate([f for f, _ in others]), np.concatenate([r for _, r in others]))
        probability = curve.probability(features)
        left_out.append((probability, right))
        by_set[name] = judge(probability, right)
    return by_set, judge(np.concatenate([p for p, _ in left_out]), np.concatenate([r for _, r in left_out]))


def _sigmoid(x: Doubles) -> Doubles:
    """1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 * (1 + np.tanh(x / 2)), np.float64)


def _check(features: Doubles, right: Booleans) -> None:
    if len(features) != len(right) or not np.isfinite(features).all():
        raise ValueError(f"{len(features)} rows of finite features are needed for {len(right)} outcomes")
    if len(right) == 0 or right.all() or not right.any():
        raise ValueError("a curve needs right and wrong answers to learn from")


def _newton(features: Doubles, right: Booleans, penalty: float) -> Doubles:
    """Minimise the penalised log loss; float64 (features + 1,), the bias last."""
    x = np.column_stack([features, np.ones(len(features))])
    ridge = np.append(np.full(features.shape[1], penalty), 1e-9)

    def loss(w: Doubles) -> float:
        z = x @ w
        return float(np.sum(np.logaddexp(0, z) - right * z) + 0.5 * np.sum(ridge * w**2))

    w = np.zeros(x.shape[1])
    for _ in range(100):
        p = _sigmoid(x @ w)
        gradient = x.T @ (p - right) + ridge * w
        hessian = (x * (p * (1 - p))[:, None]).T @ x + np.diag(ridge)
        step = np.linalg.solve(hessian, gradient)
        size = 1.0
        while size > 1e-8 and loss(w - size * step) > loss(w):  # a full step may overshoot far from the optimum
            size /= 2
        w = w - size * step
        if np.abs(size * step).max() < 1e-10:
            break
    return np.asarray(w, np.float64)
