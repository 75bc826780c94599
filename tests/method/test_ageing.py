"""Whether scores fell: told from chance, and from what all places of a map did."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, strategies as st

from worker.method.ageing import SHARE, Trend, fell_together, trend, usual_fall

FIRST = 739_676


def on_days(scores: Sequence[float], every: int = 3) -> Trend | None:
    return trend({FIRST + every * i: score for i, score in enumerate(scores)})


def some(scores: Sequence[float], every: int = 3) -> Trend:
    found = on_days(scores, every)
    assert found is not None
    return found


def test_too_few_days_or_too_near_ones_tell_nothing() -> None:
    fallen = [0.9] * 7 + [0.5] * 7
    assert on_days(fallen[1:]) is None
    assert on_days(fallen, every=2) is None  # 26 days from the first to the last
    assert some(fallen).is_ageing()


def test_a_fall_is_told_by_its_medians_and_days() -> None:
    before, after = [0.9, 0.8, 0.85, 0.9, 0.88, 0.9, 0.8, 0.84], [0.6, 0.5, 0.55, 0.6, 0.7, 0.58, 0.5, 0.62]
    fell = some([*before, *after])
    assert fell.is_ageing()
    assert (fell.since, fell.recent, fell.until) == (FIRST, FIRST + 24, FIRST + 45)
    assert fell.fall == pytest.approx(0.865 - 0.59)
    assert some([*before[:-1], 0.61, *after]).is_ageing()  # one bad day among the old ones
    assert not some([*before[:-1], 0.3, *after]).is_ageing()  # is worse than all of the new ones


def test_what_lies_between_the_oldest_and_the_newest_days_does_not_count() -> None:
    fell = some([0.9] * 15 + [0.1] * 100 + [0.89] * 15)
    assert (len(fell.old), len(fell.new)) == (15, 15)
    assert fell.fall == pytest.approx(0.01)
    assert not fell.is_ageing()


def test_a_small_fall_and_a_rise_are_no_age() -> None:
    assert not some([0.9] * 10 + [0.81] * 10).is_ageing()
    assert not some([0.5] * 10 + [0.9] * 10).is_ageing()


def test_a_place_ages_where_it_falls_more_than_its_map() -> None:
    fallen, steady = some([0.9] * 10 + [0.6] * 10), some([0.8] * 10 + [0.75] * 10)
    assert usual_fall([fallen] * 4) == 0.0  # of four places nothing is known of the map
    usual = usual_fall([fallen, *[steady] * 6])
    assert usual == pytest.approx(0.05)
    assert fallen.is_ageing(usual)
    assert not steady.is_ageing(usual)
    assert not fell_together([fallen, *[steady] * 6])


def test_places_that_fell_alike_are_the_map_and_those_that_fell_more_are_told_besides() -> None:
    alike, more = some([0.9] * 10 + [0.7] * 10), some([0.9] * 10 + [0.5] * 10)
    trends = [*[alike] * 6, more]
    assert fell_together(trends)
    assert [one.is_ageing(usual_fall(trends)) for one in trends] == [False] * 6 + [True]


def test_a_map_that_rose_makes_no_steady_place_old() -> None:
    rose, steady = some([0.5] * 10 + [0.9] * 10), some([0.8] * 20)
    assert usual_fall([*[rose] * 6, steady]) == 0.0
    assert not steady.is_ageing(usual_fall([*[rose] * 6, steady]))


def test_scores_without_a_trend_rarely_look_old() -> None:
    draw = np.random.default_rng(1)
    for days, most in ((14, 0.003), (30, 0.0005)):
        told = sum(some(draw.normal(0.7, 0.15, days).clip(0, 1).tolist()).is_ageing() for _ in range(4000))
        assert told / 4000 <= most


@given(st.lists(st.floats(0, 1), min_size=14, max_size=40))
def test_reversed_days_never_both_age(scores: list[float]) -> None:
    assert not (some(scores).is_ageing() and some(scores[::-1]).is_ageing())


@given(st.lists(st.floats(0, 1), min_size=14, max_size=40), st.floats(0, 1))
def test_beyond_a_larger_usual_fall_nothing_more_ages(scores: list[float], usual: float) -> None:
    assert some(scores).is_ageing() or not some(scores).is_ageing(usual)
    assert SHARE > 0.5
