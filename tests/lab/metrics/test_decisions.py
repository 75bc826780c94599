"""Decisions about eight queries, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from lab.metrics.decisions import Decisions, pooled, risk_coverage, summarise

EIGHT = Decisions(
    confidence=np.array([0.95, 0.9, 0.85, 0.6, 0.5, 0.3, 0.8, 0.1]),
    right=np.array([True, True, False, True, False, False, False, False]),
    status=np.array(["matched"] * 3 + ["ambiguous"] * 2 + ["no_match", "matched", "no_match"]),
    kind=np.array(["known"] * 4 + ["same-site"] * 2 + ["other-site"] * 2),
    block=np.array(list("aabbccdd")),
)
NOBODY = EIGHT.take(np.zeros(8, bool))


def test_shares_by_hand() -> None:
    found = summarise(EIGHT, np.random.default_rng(0))

    def of(name: str) -> tuple[int, int]:
        share = getattr(found, name)
        return share.events, share.queries

    assert of("right") == (3, 4)
    assert of("precision") == (2, 3)  # the other site's false accept is counted for itself
    assert of("right_matched") == (2, 3)
    assert of("right_ambiguous") == (1, 3)
    assert of("same_site_matched") == (0, 2)
    assert of("same_site_ambiguous") == (1, 2)
    assert of("other_site_matched") == (1, 2)
    assert of("other_site_ambiguous") == (0, 2)


def test_areas_by_hand() -> None:
    found = summarise(EIGHT, np.random.default_rng(0))
    # Claims in order: right, right, wrong, right, wrong, wrong; four answerable.
    assert found.average_precision.value == pytest.approx((1 + 1 + 3 / 4) / 4)
    assert found.recall_at_full_precision == pytest.approx(2 / 4)
    risks = [0, 0, 1 / 3, 1 / 4, 2 / 5, 3 / 6]
    assert found.risk_area.value == pytest.approx(np.mean(risks))
    assert found.excess_risk_area.value == pytest.approx(np.mean(risks) - np.mean([0, 0, 0, 1 / 4, 2 / 5, 3 / 6]))
    # Bins of a tenth: (.95, .9) promised .925, all right; every other bin has one query.
    errors = [2 * 0.075, 0.85, 0.4, 0.5, 0.3]
    assert found.expected_error.value == pytest.approx(sum(errors) / 6)
    assert found.risk_area.low <= found.risk_area.value <= found.risk_area.high


def test_equal_confidences_are_accepted_together() -> None:
    curve = risk_coverage(np.array([0.9, 0.5, 0.5, 0.5]), np.array([True, True, True, False]))
    assert curve.coverage.tolist() == [0.25, 1]
    assert curve.risk.tolist() == [0, 0.25]
    assert curve.area == pytest.approx((0 + 3 * 0.25) / 4)
    assert curve.least_area == pytest.approx(0.25 / 4)


def test_pooled_queries_keep_their_blocks() -> None:
    both = pooled([EIGHT, replace(EIGHT, block=np.array(list("efghijkl")))])
    assert len(both) == 16
    assert len(set(both.block)) == 12
    assert len(both.at_site) == 12


def test_no_queries_give_no_numbers() -> None:
    found = summarise(NOBODY, np.random.default_rng(0))
    assert np.isnan([found.right.value, found.risk_area.value, found.recall_at_full_precision]).all()
    assert np.isnan(risk_coverage(NOBODY.confidence, NOBODY.right).area)


def test_only_unknown_queries_have_no_recall() -> None:
    found = summarise(EIGHT.take(EIGHT.kind == "same-site"), np.random.default_rng(0))
    assert np.isnan([found.average_precision.value, found.recall_at_full_precision]).all()
    assert found.risk_area.value == 1


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot have been answered rightly"):
        replace(EIGHT, right=np.ones(8, bool))
    with pytest.raises(ValueError, match="one value a query"):
        replace(EIGHT, block=np.array(["a"]))
