"""Curves that say what they were told, and one verdict for each probability."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from worker.method.calibration import Calibration, Curve, Isotonic, Logistic

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


def kept(curve: Curve = LOGISTIC, thresholds: tuple[float, ...] = (0.5, 0.8, 0.9)) -> Calibration:
    shares = np.array([0.9, 0.6, 0.3])
    return Calibration(
        ("score",), curve, np.array([0.5, 0.9, 0.99]), np.array(thresholds), shares, 0.4, "drawn numbers"
    )


@given(st.floats(0, 1), st.floats(0.5, 0.999))
def test_every_probability_has_exactly_one_verdict(p: float, precision: float) -> None:
    limit = kept().threshold(precision)
    expected = "matched" if p >= limit else "ambiguous" if p >= 0.4 else "no_match"
    assert kept().verdict(p, precision) == expected


@given(st.floats(0.5, 0.999), st.floats(0.5, 0.999))
def test_who_wants_more_precision_gets_a_higher_threshold(a: float, b: float) -> None:
    low, high = sorted([a, b])
    assert kept().threshold(low) <= kept().threshold(high) < 1


def test_thresholds_between_and_beyond_those_that_were_learned() -> None:
    assert kept().threshold(0.7) == pytest.approx(0.65)
    assert kept().threshold(0.99) == pytest.approx(0.9)
    assert kept().threshold(0.999) == pytest.approx(0.99)
    assert kept().share(0.945) == pytest.approx(0.45)


@pytest.mark.parametrize("wrong", [float("nan"), -0.1, 1.1])
def test_what_is_no_probability_has_no_verdict(wrong: float) -> None:
    with pytest.raises(ValueError, match="no probability"):
        kept().verdict(wrong, 0.9)


def test_thresholds_must_rise() -> None:
    with pytest.raises(ValueError, match="rise"):
        kept(thresholds=(0.8, 0.5, 0.9))


@pytest.mark.parametrize("curve", [LOGISTIC, ISOTONIC])
def test_json_round_trip(curve: Curve) -> None:
    back = Calibration.from_json(kept(curve).to_json())
    scores = np.linspace(-1, 5, 50)[:, None]
    assert back.features == ("score",)
    assert back.threshold(0.95) == kept().threshold(0.95)
    assert back.share(0.95) == kept().share(0.95)
    assert back.ambiguous == 0.4
    assert back.learned_from == "drawn numbers"
    assert back.curve.probability(scores) == pytest.approx(curve.probability(scores), abs=0)


def test_an_unknown_kind_of_curve_is_refused() -> None:
    text = kept().to_json().replace("logistic", "spline")
    with pytest.raises(ValueError, match="spline"):
        Calibration.from_json(text)
