"""A map's own calibration: few labels move the shipped one little, many decide, and held-out queries judge."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.description import Booleans, Doubles
from worker.method import own_calibration
from worker.method.calibration import Calibration, Isotonic, Logistic
from worker.method.own_calibration import (
    BIAS_STIFFNESS,
    NEVER,
    STIFFNESS,
    Fitted,
    Labelled,
    OwnCalibration,
    Share,
    adjust,
    calibrate,
    choose_thresholds,
    consecutive_blocks,
)

CURVE = Logistic(np.array([0.8, -0.2]), np.array([0.6, 0.3]), np.array([2.8, 1.6]), 0.0)
SHIPPED = Calibration(
    ("gap", "level"),
    CURVE,
    np.array([0.5, 0.9, 0.97, 0.99]),
    np.array([0.4, 0.55, 0.93, 0.98]),
    np.array([0.9, 0.75, 0.5, 0.3]),
    learned_from="drawn numbers",
)


def site(seed: int, n: int, weights: tuple[float, float] = (2.8, 1.6), bias: float = 0.0) -> tuple[Doubles, Booleans]:
    """Answers of a map whose curve has these weights: features and whether they were right."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(n, 2))
    right = rng.random(n) < 1 / (1 + np.exp(-(z @ np.array(weights) + bias)))
    return z * CURVE.scale + CURVE.mean, right


def labelled(features: Doubles, right: Booleans, known: Booleans | None = None) -> Labelled:
    return Labelled(features, right, np.ones_like(right) if known is None else known, consecutive_blocks(len(right)))


def fitted(n: int, weights: tuple[float, float] = (2.8, 1.6), bias: float = 0.0, seed: int = 0) -> Fitted:
    return calibrate(labelled(*site(seed, n, weights, bias)), SHIPPED, 0.97)


# the fit


def test_nothing_to_learn_from_leaves_the_shipped_curve() -> None:
    same = adjust(CURVE, np.zeros((0, 2)), np.zeros(0, np.bool_))
    assert same.weights == pytest.approx(CURVE.weights)
    assert same.bias == pytest.approx(CURVE.bias)


def test_the_fit_is_where_labels_and_ridge_pull_alike() -> None:
    features, right = site(1, 200, (1.0, 3.0), -1.0)
    curve = adjust(CURVE, features, right)
    x = (features - CURVE.mean) / CURVE.scale
    missing = right - curve.probability(features)
    assert x.T @ missing == pytest.approx(STIFFNESS * (curve.weights - CURVE.weights), abs=1e-6)
    assert missing.sum() == pytest.approx(BIAS_STIFFNESS * (curve.bias - CURVE.bias), abs=1e-6)


def test_few_labels_move_the_curve_little_and_many_decide() -> None:
    few, many = (adjust(CURVE, *site(2, n, (1.0, 1.0), -2.0)) for n in (10, 5000))
    assert np.abs(few.weights - CURVE.weights).max() < 0.8
    assert many.weights == pytest.approx([1.0, 1.0], abs=0.15)
    assert many.bias == pytest.approx(-2.0, abs=0.15)


def test_a_feature_that_speaks_against_the_match_counts_nothing_rather_than_against_it() -> None:
    curve = adjust(CURVE, *site(3, 5000, (2.0, -2.0)))
    assert curve.weights[1] == 0.0
    assert curve.weights[0] > 1.0


def test_separable_labels_give_a_finite_curve() -> None:
    features = np.array([[3.0, 0.0]] * 500 + [[0.0, -2.0]] * 500)
    curve = adjust(CURVE, features, np.arange(1000) < 500)
    assert np.isfinite([*curve.weights, curve.bias]).all()
    assert curve.weights.max() < 10


def test_only_a_logistic_curve_can_be_adjusted() -> None:
    with pytest.raises(ValueError, match="logistic"):
        adjust(Isotonic(np.array([0.0]), np.array([0.5])), np.zeros((0, 2)), np.zeros(0, np.bool_))


# thresholds


def test_without_answers_thresholds_are_the_shipped_ones() -> None:
    chosen = choose_thresholds(np.zeros(0), np.zeros(0, np.bool_), SHIPPED)
    assert chosen == pytest.approx(SHIPPED.thresholds, abs=0.0026)


def test_a_few_right_answers_lower_a_threshold_little_and_many_do() -> None:
    few, many = (choose_thresholds(np.full(n, 0.6), np.ones(n, np.bool_), SHIPPED)[2] for n in (5, 2000))
    assert few > 0.85
    assert many <= 0.6


def test_wrong_answers_raise_a_threshold_to_where_the_precision_is_kept_or_to_never() -> None:
    sure_but_wrong = np.full(1000, 0.97)
    chosen = choose_thresholds(sure_but_wrong, np.arange(1000) % 10 > 0, SHIPPED)
    assert chosen[2] > 0.97
    wrong_everywhere = choose_thresholds(np.full(1000, 0.999), np.zeros(1000, np.bool_), SHIPPED)
    assert wrong_everywhere.tolist() == [NEVER] * 4


# judged on held-out queries


def test_a_map_that_differs_is_calibrated_and_keeps_the_precision_that_is_wanted() -> None:
    found = fitted(600, (2.8, 1.6), -2.0)
    assert found.transfers
    assert found.own_does.log_loss < found.shipped_does.log_loss - 0.05
    assert found.own_does.expected_error < found.shipped_does.expected_error

    features, right = site(99, 20_000, (2.8, 1.6), -2.0)

    def kept(calibration: Calibration) -> float:
        matched = calibration.curve.probability(features) >= calibration.threshold(0.97)
        return float(right[matched].mean())

    assert kept(SHIPPED) < 0.9
    assert kept(found.own.calibration) > 0.95


def test_a_map_where_answers_are_easier_matches_more() -> None:
    found = fitted(600, (5.0, 0.5), 1.0)
    assert found.transfers
    ours, theirs = found.own_does.matched_share.value, found.shipped_does.matched_share.value
    assert ours is not None
    assert theirs is not None
    assert ours > theirs + 0.2


def test_what_was_learned_from_noise_does_not_transfer() -> None:
    """The shipped curve is right here, and labels can only lead away from it."""
    assert [fitted(25, seed=seed).transfers for seed in range(8)].count(False) >= 5


def test_labels_that_contradict_each_other_from_block_to_block_do_not_transfer() -> None:
    features, right = site(5, 300)
    blocks = np.arange(300) // 150
    swapped = np.where(blocks == 0, right, ~right)
    found = calibrate(replace(labelled(features, swapped), blocks=blocks), SHIPPED, 0.97)
    assert found.folds == 2
    assert not found.transfers


def test_queries_are_judged_by_a_curve_that_has_not_seen_their_block() -> None:
    """Copies of one query in a block: a curve that had seen them would know them."""
    features, right = site(6, 40)
    copies = np.repeat(np.arange(40), 25)
    together = Labelled(features[copies], right[copies], right[copies], copies)
    apart = replace(together, blocks=np.arange(1000))
    held_out, leaked = (calibrate(one, SHIPPED, 0.97).own_does.log_loss for one in (together, apart))
    assert held_out > leaked


def test_thresholds_that_judge_queries_do_not_depend_on_their_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    features, right = site(9, 100)
    chosen: list[Doubles] = []

    def choosing(probability: Doubles, right: Booleans, shipped: Calibration) -> Doubles:
        chosen.append(choose_thresholds(probability, right, shipped))
        return chosen[-1]

    monkeypatch.setattr(own_calibration, "choose_thresholds", choosing)
    first = np.arange(100) < 20
    for labels in (right, right ^ first):
        calibrate(Labelled(features, labels, labels, np.arange(100) // 20), SHIPPED, 0.97)
    assert chosen[0].tolist() == chosen[6].tolist(), "the fold of the first block"
    assert chosen[5].tolist() != chosen[11].tolist(), "of all of them"


def test_false_accepts_are_counted_among_queries_whose_place_the_map_lacks() -> None:
    features, right = site(7, 400, (1.0, 1.0), -1.0)
    found = calibrate(labelled(features, right, known=right), SHIPPED, 0.97)
    unknown = found.shipped_does.false_accepts
    assert unknown.of == int((~right).sum())
    assert unknown.count == found.shipped_does.precision.of - found.shipped_does.precision.count > 0


def test_the_order_of_blocks_and_their_numbers_do_not_matter() -> None:
    one = labelled(*site(8, 200, bias=-1.0))
    same = replace(one, blocks=one.blocks * 7 + 3)
    assert calibrate(one, SHIPPED, 0.9).own.to_json() == calibrate(same, SHIPPED, 0.9).own.to_json()


# what is needed


@pytest.mark.parametrize(
    ("n", "right", "blocks", "lack"),
    [
        (19, [True, False], None, "19 labelled queries with an answer; at least 20"),
        (40, [True], None, "all answers are right"),
        (40, [False], None, "all answers are wrong"),
        (40, [True, False], 1, "one block"),
        (0, [], None, "0 labelled queries"),
    ],
)
def test_what_is_missing_is_said(n: int, right: list[bool], blocks: int | None, lack: str) -> None:
    outcomes = np.resize(np.array(right, np.bool_), n)
    some = labelled(np.zeros((n, 2)), outcomes)
    if blocks is not None:
        some = replace(some, blocks=np.zeros(n, np.intp))
    assert any(lack in one for one in some.missing())
    with pytest.raises(ValueError, match=lack):
        calibrate(some, SHIPPED, 0.97)


def test_labels_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        labelled(np.full((3, 2), np.nan), np.ones(3, np.bool_))
    with pytest.raises(ValueError, match="as many"):
        replace(labelled(np.zeros((3, 2)), np.ones(3, np.bool_)), right=np.ones(4, np.bool_))


def test_consecutive_queries_share_blocks() -> None:
    assert consecutive_blocks(7).tolist() == [0, 0, 0, 1, 1, 1, 2]
    assert np.bincount(consecutive_blocks(1000)).tolist() == [50] * 20
    assert consecutive_blocks(0).tolist() == []


# figures


def test_intervals_by_hand() -> None:
    assert Share(8, 10).interval == pytest.approx((0.4902, 0.9433), abs=1e-4)  # Wilson's, from tables
    assert Share(0, 10).interval == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert (Share(0, 0).value, Share(0, 0).interval) == (None, (0.0, 1.0))


def test_it_comes_back_from_json_as_it_was() -> None:
    own = replace(fitted(300).own, made_at="2026-03-01T12:00:00+00:00")
    back = OwnCalibration.from_json(own.to_json())
    assert back.to_json() == own.to_json()
    assert (back.queries, back.made_at) == (300, own.made_at)
    assert back.precision(0.97) == own.precision(0.97)
    assert back.calibration.learned_from == "drawn numbers; 300 labelled queries of the map"


def test_a_precision_that_nothing_was_matched_at_is_unknown() -> None:
    own = OwnCalibration(SHIPPED, np.array([0.6, 0.9, np.nan, np.nan]), 30)
    back = OwnCalibration.from_json(own.to_json())
    assert back.precision(0.9) == pytest.approx(0.9)
    assert back.precision(0.99) is None
