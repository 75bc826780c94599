"""Curves and thresholds learned from labelled queries, and how well they do on queries they were not learned from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from lab.libraries import for_studies
from lab.metrics.recall import Indices
from schemas.description import Booleans, Doubles
from worker.method.calibration import Curve, Isotonic, Logistic

Fit = Callable[[Doubles, Booleans], Curve]
"""From features (n, features) and outcomes (n,) to a curve."""


def fit_logistic(features: Doubles, right: Booleans, *, penalty: float = 1.0) -> Logistic:
    """Fit a logistic curve: least log loss with an L2 penalty and no negative weight (L-BFGS-B).

    Parameters
    ----------
    features : float64 of shape (n, features)
        Each should grow with the evidence for a match; one that does not gets the weight 0.
    right : bool of shape (n,)
    penalty : float
        On the squared weights of standardised features; the bias is free. Without it, perfectly separated
        queries would give an infinitely steep curve.

    Raises
    ------
    ValueError
        When the queries are all right or all wrong: nothing can be learned from them.
    """
    with for_studies():
        from scipy.optimize import minimize  # type: ignore[import-untyped]
        from scipy.special import expit  # type: ignore[import-untyped]
    _check(features, right)
    mean, scale = features.mean(axis=0), features.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    x = np.column_stack([(features - mean) / scale, np.ones(len(features))])
    ridge = np.append(np.full(features.shape[1], penalty), 0.0)

    def loss(solution: Doubles) -> tuple[float, Doubles]:
        """Mean penalised log loss, and its gradient."""
        z = x @ solution
        value = np.sum(np.logaddexp(0, z) - right * z) + 0.5 * np.sum(ridge * solution**2)
        return float(value) / len(x), (x.T @ (expit(z) - right) + ridge * solution) / len(x)

    bounds = [(0, None)] * features.shape[1] + [(None, None)]
    accuracy = {"ftol": 1e-15, "gtol": 1e-9}
    solution = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds, options=accuracy).x
    return Logistic(mean, scale, np.asarray(solution[:-1], np.float64), float(solution[-1]))


def fit_isotonic(features: Doubles, right: Booleans) -> Isotonic:
    """Fit the never-falling curve nearest to the outcomes (pool adjacent violators).

    Parameters
    ----------
    features : float64 of shape (n, 1)
    right : bool of shape (n,)

    Returns
    -------
    Isotonic
        With a knot at the mean feature of each pooled block. Values keep away from 0 and 1 by half a query in
        n + 1: a hundred right answers do not prove certainty.

    Raises
    ------
    ValueError
        As `fit_logistic`, and for more than one feature.
    """
    with for_studies():
        from scipy.optimize import isotonic_regression
    _check(features, right)
    if features.shape[1] != 1:
        raise ValueError(f"an isotonic curve reads one feature, not {features.shape[1]}")
    names, group = np.unique(features[:, 0], return_inverse=True)
    count = np.bincount(group).astype(np.float64)
    pooled = isotonic_regression(np.bincount(group, weights=right) / count, weights=count)
    starts = pooled.blocks[:-1]
    knots = np.add.reduceat(names * count, starts) / np.add.reduceat(count, starts)
    edge = 0.5 / (len(features) + 1)
    return Isotonic(knots, np.clip(pooled.x[starts], edge, 1 - edge))


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
    """How a curve did on queries it was not learned from.

    Parameters
    ----------
    queries : int
    expected_error : float
        Expected calibration error.
    brier : float
        Mean squared difference between probability and outcome.
    log_loss : float
        Mean negative natural logarithm of the probability of what came true.
    """

    queries: int
    expected_error: float
    brier: float
    log_loss: float


def judge(probability: Doubles, right: Booleans) -> Judgement:
    """How far probabilities, float64 (n,), can be taken at their word."""
    safe = np.clip(probability, 1e-12, 1 - 1e-12)
    loss = -np.mean(np.where(right, np.log(safe), np.log1p(-safe)))
    brier = float(np.mean((probability - right) ** 2))
    return Judgement(len(right), reliability(probability, right).expected_error, brier, float(loss))


def leave_one_out(sets: Mapping[str, tuple[Doubles, Booleans]], fit: Fit) -> dict[str, Doubles]:
    """Probabilities of each set's answers by a curve learned from all other sets, float64 (n,) each.

    Parameters
    ----------
    sets : mapping of name to (features, right)
        float64 (n, features) and bool (n,).
    fit : function

    Raises
    ------
    ValueError
        There are fewer than two sets, or nothing can be learned from the others.
    """
    if len(sets) < 2:
        raise ValueError("leaving one set out needs at least two")
    left_out = {}
    for name, (features, _) in sets.items():
        others = [pair for other, pair in sets.items() if other != name]
        curve = fit(np.concatenate([f for f, _ in others]), np.concatenate([r for _, r in others]))
        left_out[name] = curve.probability(features)
    return left_out


def _check(features: Doubles, right: Booleans) -> None:
    if len(features) != len(right) or not np.isfinite(features).all():
        raise ValueError(f"{len(features)} rows of finite features are needed for {len(right)} outcomes")
    if len(right) == 0 or right.all() or not right.any():
        raise ValueError("a curve needs right and wrong answers to learn from")
