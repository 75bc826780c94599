"""Recall, chance and ceiling against hand-worked numbers."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lab.metrics.recall import (
    Truth,
    bootstrap_interval,
    ceiling,
    chance,
    chance_of_each,
    first_right,
    found_within,
    recall,
    share_interval,
)

RANKED = np.array([[2, 0, 1, 3], [3, 1, 0, 2], [0, 1, 2, 3]])
TRUTH = Truth.of([[0, 3], [], [3]], 4)


def test_three_queries_by_hand() -> None:
    first = first_right(RANKED, TRUTH)
    assert first.tolist() == [2, 0, 4]
    assert recall(first, depths=(1, 2, 4)).tolist() == [0, 1 / 3, 2 / 3]
    assert recall(first, TRUTH.answerable, (1, 2, 4)).tolist() == [0, 0.5, 1]
    assert ceiling(TRUTH) == pytest.approx(2 / 3)
    assert ceiling(TRUTH, TRUTH.answerable) == 1


def test_missing_answers_are_never_right() -> None:
    assert first_right(np.array([[-1, -1]]), Truth.of([[1]], 2)).tolist() == [0]


def test_an_answer_from_the_future_is_refused() -> None:
    with pytest.raises(ValueError, match="outside the database"):
        first_right(np.array([[5]]), Truth.of([[1]], 5))


def test_truth_refuses_right_answers_that_cannot_be_searched() -> None:
    with pytest.raises(ValueError, match="query 1"):
        Truth.of([[0], [4]], np.array([5, 4]))


def test_chance_by_hand() -> None:
    # One right among four: 1/4 at 1, 2/4 at 2. Two among four: 1 - (2/4)(1/3) = 5/6 at 2.
    each = chance_of_each(Truth.of([[0], [1, 2], []], 4), (1, 2, 4))
    assert each == pytest.approx(np.array([[0.25, 0.5, 1], [0.5, 5 / 6, 1], [0, 0, 0]]))


def test_chance_equals_the_mean_over_all_orders() -> None:
    truth = Truth.of([[1, 4]], 5)
    orders = np.array(list(permutations(range(5))))
    every = Truth.of([[1, 4]] * len(orders), 5)
    assert recall(first_right(orders, every), depths=(1, 2, 3)) == pytest.approx(chance(truth, depths=(1, 2, 3)))


def test_chance_in_a_database_smaller_than_n() -> None:
    assert chance(Truth.of([[0]], 3), depths=(20,)).tolist() == [1]


def test_the_readme_of_gardenspoint_gives_the_same_chance() -> None:
    # 200 images, +-2 frames: five right answers, fewer at both ends of the walk.
    truth = Truth.of([list(range(max(0, i - 2), min(200, i + 3))) for i in range(200)], 200)
    assert chance(truth, depths=(1, 5, 10)) == pytest.approx([0.025, 0.119, 0.227], abs=5e-4)


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.integers(1, 10))
def test_recall_never_falls_with_n_and_never_exceeds_the_ceiling(seed: int, size: int, queries: int) -> None:
    rng = np.random.default_rng(seed)
    truth = Truth.of([rng.choice(size, rng.integers(0, size), replace=False) for _ in range(queries)], size)
    first = first_right(np.array([rng.permutation(size) for _ in range(queries)]), truth)
    values = recall(first, depths=(1, 2, 5, 10, 20, 40))
    assert (np.diff(values) >= 0).all()
    assert values.max() <= ceiling(truth)
    expected = chance(truth, depths=(1, 2, 5, 10, 20, 40))
    assert (np.diff(expected) >= -1e-12).all()
    assert expected.max() <= ceiling(truth) + 1e-12


def test_bootstrap_is_seeded_and_about_right() -> None:
    found = found_within(np.repeat([1, 0], 100), (1,))
    low, high = bootstrap_interval(found, np.random.default_rng(0))
    again = bootstrap_interval(found, np.random.default_rng(0))
    assert (low[0], high[0]) == (again[0][0], again[1][0])
    # The normal approximation gives 0.5 +- 1.96 sqrt(.25 / 200) = 0.431 .. 0.569.
    assert low[0] == pytest.approx(0.431, abs=0.015)
    assert high[0] == pytest.approx(0.569, abs=0.015)


def test_neighbours_that_succeed_together_widen_the_interval() -> None:
    found = found_within(np.repeat([1, 0] * 10, 10), (1,))
    narrow = np.subtract(*bootstrap_interval(found, np.random.default_rng(0))[::-1])[0]
    wide = np.subtract(*bootstrap_interval(found, np.random.default_rng(0), block=20)[::-1])[0]
    single = np.subtract(*bootstrap_interval(found, np.random.default_rng(0), block=10)[::-1])[0]
    assert single > 1.5 * narrow
    assert wide < single  # two runs of opposite outcome in each block: the resamples hardly differ


@pytest.mark.parametrize("queries", [2, 9, 10, 12])
def test_a_walk_as_short_as_a_run_is_no_certainty(queries: int) -> None:
    found = np.ones((queries, 1), bool)
    found[0] = False
    low, high = share_interval(found, np.random.default_rng(0), block=10)
    assert low[0] < found.mean() < high[0]
    all_low, _ = share_interval(np.ones((queries, 1), bool), np.random.default_rng(0), block=10)
    assert all_low[0] == pytest.approx(0.025 ** (max(1, queries // 3) / queries))


def test_no_queries_no_number() -> None:
    assert np.isnan(recall(np.zeros(0, np.int64), depths=(1,))).all()
    assert np.isnan(bootstrap_interval(np.zeros((0, 2)), np.random.default_rng(0))[0]).all()


def test_none_of_a_few_is_not_certainty() -> None:
    found = np.zeros((30, 1), bool)
    low, high = share_interval(found, np.random.default_rng(0))
    assert low[0] == 0
    assert high[0] == pytest.approx(1 - 0.025 ** (1 / 30))  # the exact binomial bound, 0.116
    low, high = share_interval(~found, np.random.default_rng(0), block=10)
    assert low[0] == pytest.approx(0.025 ** (1 / 3))
    assert high[0] == 1
