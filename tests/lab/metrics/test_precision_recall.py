"""Precision and recall of "I have been here", by hand."""

import numpy as np
import pytest

from lab.metrics.precision_recall import correct_rejection, precision_recall

CONFIDENCE = np.array([0.9, 0.8, 0.8, 0.5, 0.3])
RIGHT = np.array([True, True, False, True, False])
ANSWERABLE = np.array([True, True, False, True, True])


def test_five_queries_by_hand() -> None:
    curve = precision_recall(CONFIDENCE, RIGHT, ANSWERABLE)
    assert curve.thresholds.tolist() == [0.9, 0.8, 0.5, 0.3]
    assert curve.precision.tolist() == pytest.approx([1, 2 / 3, 3 / 4, 3 / 5])
    assert curve.recall.tolist() == pytest.approx([1 / 4, 2 / 4, 3 / 4, 3 / 4])
    assert curve.recall_at_full_precision == 0.25
    best, threshold = curve.best_f1
    assert best == pytest.approx(0.75)
    assert threshold == 0.5
    assert curve.average_precision == pytest.approx(1 / 4 * 1 + 1 / 4 * 2 / 3 + 1 / 4 * 3 / 4)


def test_rejection_by_hand() -> None:
    assert correct_rejection(CONFIDENCE >= 0.85, ANSWERABLE) == 1
    assert correct_rejection(CONFIDENCE >= 0.5, ANSWERABLE) == 0
    assert np.isnan(correct_rejection(CONFIDENCE >= 0.5, np.ones(5, bool)))


def test_a_constant_scorer_has_one_point() -> None:
    curve = precision_recall(np.full(5, 0.5), RIGHT, ANSWERABLE)
    assert len(curve.thresholds) == 1
    assert curve.recall_at_full_precision == 0


def test_perfect_knowledge() -> None:
    curve = precision_recall(np.array([0.9, 0.8, 0.1]), np.array([True, True, False]), np.array([True, True, False]))
    assert curve.best_f1 == (1.0, 0.8)
    assert curve.recall_at_full_precision == 1


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="NaN"):
        precision_recall(np.array([np.nan]), np.array([True]), np.array([True]))
    with pytest.raises(ValueError, match="answered rightly"):
        precision_recall(np.array([0.5]), np.array([True]), np.array([False]))
