"""Intervals of shares and areas, by hand."""

import numpy as np
import pytest

from lab.metrics.intervals import block_bootstrap, exact_interval, share
from lab.metrics.recall import Indices

RNG = np.random.default_rng


def test_nothing_in_many_trials_has_an_upper_bound() -> None:
    low, high = exact_interval(0, 2390)
    assert low == 0
    assert high == pytest.approx(1 - 0.025 ** (1 / 2390))
    assert 1000 * high == pytest.approx(1.54, abs=0.005)


def test_clopper_and_pearson_by_hand() -> None:
    # One of two: P(at least 1 of 2) = 1 - (1 - low)^2 = .025 and P(at most 1 of 2) = 1 - high^2 = .025.
    assert exact_interval(1, 2) == pytest.approx((1 - np.sqrt(0.975), np.sqrt(0.975)))
    assert exact_interval(5, 5) == pytest.approx((0.025 ** (1 / 5), 1))
    assert np.isnan(exact_interval(0, 0)).all()


def test_blocks_of_alike_queries_say_less_than_single_ones() -> None:
    happened, everyone = np.repeat([True, False], 50), np.ones(100, bool)
    single = share(happened, everyone, np.arange(100).astype(str), RNG(0))
    tens = share(happened, everyone, (np.arange(100) // 10).astype(str), RNG(0))
    assert single.value == tens.value == 0.5
    # Standard errors .05 and .158, times 1.96.
    assert (single.low, single.high) == pytest.approx((0.4, 0.6), abs=0.02)
    assert (tens.low, tens.high) == pytest.approx((0.2, 0.8), abs=0.01)
    assert (single.exact_low, single.exact_high) == (tens.exact_low, tens.exact_high)


def test_nothing_happened_in_few_blocks() -> None:
    found = share(np.zeros(30, bool), np.ones(30, bool), np.repeat(["a", "b", "c"], 10), RNG(0))
    assert (found.events, found.queries, found.low) == (0, 30, 0)
    assert found.high == pytest.approx(1 - 0.025 ** (1 / 3))
    assert found.exact_high == pytest.approx(1 - 0.025 ** (1 / 30))


def test_everything_happened_in_few_blocks() -> None:
    found = share(np.ones(30, bool), np.ones(30, bool), np.repeat(["a", "b", "c"], 10), RNG(0))
    assert (found.value, found.high) == (1, 1)
    assert found.low == pytest.approx(0.025 ** (1 / 3))


def test_the_share_is_among_some_and_their_number_varies_too() -> None:
    # Two blocks: one with 8 of 8 matched right, one with 0 of 2. Draws: 8/8, 8/10, 0/2.
    happened = np.array([True] * 8 + [False] * 12)
    among = np.array([True] * 10 + [False] * 10)
    blocks = np.array(["a"] * 8 + ["b"] * 12)
    found = share(happened, among, blocks, RNG(0))
    assert (found.events, found.queries) == (8, 10)
    assert (found.low, found.high) == (0, 1)


def test_a_single_block_says_what_its_queries_say() -> None:
    found = share(np.arange(10) > 0, np.ones(10, bool), np.repeat("a", 10), RNG(0))
    assert (found.low, found.high) == (found.exact_low, found.exact_high)
    assert found.low < 0.6 < found.value < found.high
    assert np.isnan(block_bootstrap(np.repeat("a", 10), lambda _: 0.9, RNG(0))).all()


def test_a_share_of_nobody_is_no_number() -> None:
    found = share(np.ones(3, bool), np.zeros(3, bool), np.array(["a", "b", "c"]), RNG(0))
    assert found.queries == 0
    assert np.isnan([found.value, found.low, found.high]).all()


def test_any_statistic_is_drawn_by_blocks() -> None:
    values = np.array([1.0, 1.0, 0.0, 0.0])
    low, high = block_bootstrap(np.array(["a", "a", "b", "b"]), lambda drawn: float(values[drawn].mean()), RNG(0))
    assert (low, high) == (0, 1)  # both a, one of each, both b
    met: list[float] = []

    def mean(drawn: Indices) -> float:
        met.append(float(values[drawn].mean()))
        return met[-1]

    block_bootstrap(np.array(["a", "a", "b", "b"]), mean, RNG(0))
    assert set(met) == {0.0, 0.5, 1.0}


def test_draws_without_a_value_are_left_out() -> None:
    blocks = np.array(["a", "b"])
    only_a = block_bootstrap(blocks, lambda drawn: 0.3 if 0 in drawn else float("nan"), RNG(0))
    assert only_a == pytest.approx((0.3, 0.3))
    assert np.isnan(block_bootstrap(blocks, lambda _: float("nan"), RNG(0))).all()
    assert np.isnan(block_bootstrap(blocks[:0], lambda _: 1.0, RNG(0))).all()
