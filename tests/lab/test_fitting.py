"""Probabilities that mean what they say."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lab.fitting import (
    fit_isotonic,
    fit_logistic,
    judge,
    leave_one_out,
    reliability,
)
from schemas.description import Booleans, Doubles


def drawn(seed: int, n: int = 4000, shift: float = 0.0) -> tuple[Doubles, Booleans]:
    """Scores whose chance of being right is 1 / (1 + exp(-(2 s - 1))), and a column of noise."""
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal(n) + shift
    right = rng.random(n) < 1 / (1 + np.exp(-(2 * scores - 1)))
    return np.column_stack([scores, rng.standard_normal(n)]), right


def test_the_logistic_curve_finds_the_law_behind_the_data() -> None:
    curve = fit_logistic(*drawn(0, 40_000))
    slope = curve.weights / curve.scale
    assert slope[0] == pytest.approx(2, abs=0.1)
    assert slope[1] == pytest.approx(0, abs=0.05)
    assert curve.bias - slope @ curve.mean == pytest.approx(-1, abs=0.1)


def test_both_curves_are_calibrated_on_other_data() -> None:
    features, right = drawn(1)
    fresh, truth = drawn(2)
    assert judge(fit_logistic(features, right).probability(fresh), truth).expected_error < 0.03
    assert judge(fit_isotonic(features[:, :1], right).probability(fresh[:, :1]), truth).expected_error < 0.03


def test_isotonic_by_hand() -> None:
    # Outcomes 0 1 | 0 pooled to 1/2, then 1: three blocks 0, 1/2, 1.
    curve = fit_isotonic(np.array([[1.0], [2], [3], [4]]), np.array([False, True, False, True]))
    assert curve.scores.tolist() == [1, 2.5, 4]
    assert curve.values.tolist() == pytest.approx([0.1, 0.5, 0.9])  # 0 and 1 kept half a query in five away


def test_equal_scores_are_one_knot_by_hand() -> None:
    # 1 twice, half right; 2 once, right: pooled blocks are 1/2 and 1.
    curve = fit_isotonic(np.array([[1.0], [1], [2]]), np.array([False, True, True]))
    assert curve.scores.tolist() == [1, 2]
    assert curve.values.tolist() == pytest.approx([0.5, 0.875])


def test_an_isotonic_curve_reads_one_feature() -> None:
    with pytest.raises(ValueError, match="one feature"):
        fit_isotonic(*drawn(0, 10))


def test_a_feature_that_contradicts_gets_no_weight() -> None:
    features, right = drawn(3)
    curve = fit_logistic(np.column_stack([features[:, 0], -features[:, 0] + features[:, 1]]), right)
    assert (curve.weights >= 0).all()
    assert curve.weights[1] == 0


def test_separable_queries_give_a_finite_curve() -> None:
    curve = fit_logistic(np.array([[0.0], [1], [2], [3]]), np.array([False, False, True, True]))
    p = curve.probability(np.array([[0.0], [3.0]]))
    assert 0 < p[0] < 0.5 < p[1] < 1


def test_nothing_to_learn_is_said() -> None:
    for fit in (fit_logistic, fit_isotonic):
        with pytest.raises(ValueError, match="right and wrong"):
            fit(np.zeros((3, 1)), np.ones(3, bool))
        with pytest.raises(ValueError, match="finite"):
            fit(np.full((2, 1), np.nan), np.array([True, False]))


@given(st.lists(st.tuples(st.floats(-10, 10), st.booleans()), min_size=2, max_size=40))
def test_neither_curve_ever_falls(queries: list[tuple[float, bool]]) -> None:
    scores, right = np.array([[s] for s, _ in queries]), np.array([r for _, r in queries])
    if right.all() or not right.any():
        return
    grid = np.linspace(-12, 12, 50)[:, None]
    for curve in (fit_logistic(scores, right), fit_isotonic(scores, right)):
        p = curve.probability(grid)
        assert (np.diff(p) >= -1e-12).all()
        assert ((p >= 0) & (p <= 1)).all()


def test_reliability_by_hand() -> None:
    bins = reliability(np.array([0.05, 0.95, 1.0, 0.95]), np.array([False, True, True, False]))
    assert bins.counts.tolist() == [1, 0, 0, 0, 0, 0, 0, 0, 0, 3]
    assert bins.expected_error == pytest.approx(1 / 4 * 0.05 + 3 / 4 * abs(2.9 / 3 - 2 / 3))


def test_a_set_that_is_unlike_the_others_shows() -> None:
    features, right = drawn(6)
    sets = {"a": drawn(4), "b": drawn(5), "odd": (features + 3, right)}
    left_out = leave_one_out(sets, fit_logistic)
    assert judge(left_out["odd"], right).expected_error > 0.2
    assert {name: len(p) for name, p in left_out.items()} == {"a": 4000, "b": 4000, "odd": 4000}
    with pytest.raises(ValueError, match="at least two"):
        leave_one_out({"a": drawn(4)}, fit_logistic)
