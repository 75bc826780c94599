"""Curves that say what they were told, and one verdict for each probability."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.method.calibration import Calibration, Curve, Isotonic, Logistic, Thresholds

LOGISTIC = Logistic(np.array([0.5]), np.array([0.1]), np.array([2.0]), -1.0)
ISOTONIC = Isotonic(np.array([1.0, 2.5, 4.0]), np.array([0.1, 0.5, 0.9]))


def test_a_logistic_curve_by_hand() -> None:
    # (0.5 - 0.5) / 0.1 * 2 - 1 = -1, and (0.6 - 0.5) / 0.1 * 2 - 1 = 1.
    low, high = LOGISTIC.probability(np.array([[0.5], [0.6]])).tolist()
    assert low == pytest.approx(1 / (1 + np.e))
    assert high == pytest.approx(1 - low)


def test_an_isotonic_curve_by_hand() -> None:
    assert ISOTONIC.probability(np.array([[0.0], [1.75], [9.0]])).tolist() == pytest.approx([0.1, 0.3, 0.9])


@pytest.mark.parametrize("curve", [LOGISTIC, ISOTONIC])
def test_features_of_another_shape_are_refused(curve: Curve) -> None:
    with pytest.raises(ValueError, match="shape"):
        curve.probability(np.zeros((3, 2)))


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1))
def test_every_probability_has_exactly_one_verdict(p: float, a: float, b: float) -> None:
    limits = Thresholds(matched=max(a, b), ambiguous=min(a, b))
    assert [p >= limits.matched, limits.ambiguous <= p < limits.matched, p < limits.ambiguous].count(True) == 1
    expected = "matched" if p >= limits.matched else "ambiguous" if p >= limits.ambiguous else "no_match"
    assert limits.verdict(p) == expected


@pytest.mark.parametrize("wrong", [float("nan"), -0.1, 1.1])
def test_what_is_no_probability_has_no_verdict(wrong: float) -> None:
    with pytest.raises(ValueError, match="no probability"):
        Thresholds().verdict(wrong)


def test_thresholds_must_rise() -> None:
    with pytest.raises(ValueError, match="rise"):
        Thresholds(matched=0.2, ambiguous=0.5)


@pytest.mark.parametrize("curve", [LOGISTIC, ISOTONIC])
def test_json_round_trip(curve: Curve) -> None:
    kept = Calibration(("score",), curve, Thresholds(0.9, 0.2), "drawn numbers")
    back = Calibration.from_json(kept.to_json())
    scores = np.linspace(-1, 5, 50)[:, None]
    assert back.features == ("score",)
    assert back.thresholds == kept.thresholds
    assert back.learned_from == "drawn numbers"
    assert back.curve.probability(scores) == pytest.approx(curve.probability(scores), abs=0)


def test_an_unknown_kind_of_curve_is_refused() -> None:
    text = Calibration(("score",), LOGISTIC).to_json().replace("logistic", "spline")
    with pytest.raises(ValueError, match="spline"):
        Calibration.from_json(text)
