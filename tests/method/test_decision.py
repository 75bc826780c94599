"""Evidence, confidences and verdicts."""

from typing import Any

import numpy as np
import pytest

from worker.method.calibration import Calibration, Logistic, Thresholds
from worker.method.cascade import DenseEvidence, RankedCandidate
from worker.method.decision import UNCALIBRATED, decide, features
from worker.method.verification import Verified


def found(
    score: float,
    similarity: float | None = None,
    median_similarity: float = 0.0,
    p85_similarity: float = 0.0,
    inliers: int = 0,
    **parts: Any,
) -> RankedCandidate:
    dense = None if similarity is None else DenseEvidence(similarity, median_similarity, p85_similarity, (0, 0), 1.0)
    verified = Verified(inliers, inliers, None, np.zeros((inliers, 4), np.float32)) if inliers else None
    return RankedCandidate(1, score, parts, {}, {}, dense, None, verified)


def by(feature: str, steepness: float = 10.0) -> Calibration:
    curve = Logistic(np.array([0.3]), np.array([1.0]), np.array([steepness]), 0.0)
    return Calibration((feature,), curve, Thresholds(matched=0.9, ambiguous=0.4), "a test")


def test_the_evidence_of_each_match() -> None:
    read = features(
        [found(0.8, 0.7, 0.2, 0.3, inliers=9, dense_full=0.5), found(0.6), found(0.5, 0.1, 0.2, dense_full=0.1)]
    )
    assert read["score"].tolist() == [0.8, 0.6, 0.5]
    assert read["lead"] == pytest.approx([0.2, -0.2, -0.3])
    assert read["standing"] == pytest.approx([0.5, 0.0, -0.1])
    assert read["margin"] == pytest.approx([0.4, 0.0, 0.1])
    assert read["inliers"] == pytest.approx([np.log(10), 0, 0])
    assert read["part.dense_full"].tolist() == [0.5, 0.0, 0.1]


def test_a_view_that_stands_out_is_matched_and_one_among_many_alike_is_not() -> None:
    outstanding, usual = (
        found(0.6, similarity=0.9, median_similarity=0.2),
        found(0.6, similarity=0.9, median_similarity=0.85),
    )
    assert decide([outstanding], by("standing")).status == "matched"
    assert decide([usual], by("standing")).status == "no_match"


def test_an_unknown_place_that_looks_like_the_few_views_of_its_kind_is_not_matched() -> None:
    place, unknown_place = (
        found(0.6, 0.9, median_similarity=0.1, p85_similarity=0.2),
        found(0.6, 0.9, median_similarity=0.1, p85_similarity=0.85),
    )
    assert decide([place], by("margin")).status == "matched"
    assert decide([unknown_place], by("margin")).status == "no_match"


def test_confidence_never_rises_with_rank() -> None:
    attributes = decide([found(0.8, 0.5, 0.2), found(0.7, 0.9, 0.2), found(0.1, 0.1, 0.2)], by("standing"))
    assert attributes.confidence == attributes.confidences[0] == attributes.confidences[1] > attributes.confidences[2]


def test_nothing_found_is_no_match_and_a_feature_never_seen_is_no_evidence() -> None:
    assert decide([], UNCALIBRATED).status == "no_match"
    assert decide([found(0.9)], by("part.unheard of")).confidence < 0.05
