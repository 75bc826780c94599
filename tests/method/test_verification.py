"""Matches of local features, the transform they agree on, and the score of their number."""

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from schemas.description import Floats, LocalFeatures
from schemas.errors import DescriptorMismatch
from worker.method import verification


def scattered(seed: int, count: int) -> Floats:
    drawn: Floats = np.random.default_rng(seed).uniform(0.05, 0.7, (count, 2)).astype(np.float32)
    return drawn


def features(positions: Floats, seed: int) -> LocalFeatures:
    drawn = np.random.default_rng(seed).normal(size=(len(positions), 48))
    unit = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    return LocalFeatures(positions.astype(np.float32), np.rint(unit * 127).astype(np.int8))


def moved(positions: Floats, zoom: float, turn: float, by: tuple[float, float]) -> Floats:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    there: Floats = (zoom * positions @ rotation.T + by).astype(np.float32)
    return there


def test_a_match_is_mutual_and_clearly_better_than_the_second_best() -> None:
    query = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 2]], np.float32)
    view = np.array([[0, 1, 0.5], [0, 1, -0.5], [1, 0, 0], [0, 0, 1]], np.float32)
    [pairs] = verification.match(query, [view])
    # Row 1 has two equally good partners and is dropped; row 0 is exact and comes first.
    assert pairs.tolist() == [[0, 2], [2, 3]]


def test_of_equal_descriptors_the_first_has_the_match() -> None:
    twice = np.array([[1, 0], [1, 0]], np.float32)
    [pairs] = verification.match(twice, [np.array([[1, 0], [0, 1]], np.float32)])
    assert pairs.tolist() == [[0, 0]]


def test_nothing_matches_nothing() -> None:
    none = features(scattered(0, 0), 0)
    [found] = verification.verify(none, [features(scattered(0, 9), 0)])
    assert (found.inliers, found.matches, found.transform) == (0, 0, None)
    assert found.pairs.shape == (0, 4)
    assert [view.matches for view in verification.verify(features(scattered(0, 9), 0), [none, none])] == [0, 0]
    assert verification.verify(none, []) == []


def test_descriptors_of_other_lengths_are_refused() -> None:
    with pytest.raises(DescriptorMismatch):
        verification.match(np.ones((2, 3), np.float32), [np.ones((2, 4), np.float32)])


def test_a_known_transform_is_found_among_wrong_matches() -> None:
    source = scattered(1, 40)
    target = moved(source, 1.2, 0.1, (0.05, -0.02))
    target[25:] = scattered(2, 15)
    order = np.random.default_rng(3).permutation(40)
    transform, inliers = verification.consensus(source[order], target[order])
    assert transform is not None
    assert set(np.flatnonzero(order < 25)) <= set(np.flatnonzero(inliers))
    assert inliers.sum() <= 27
    expected = 1.2 * np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    np.testing.assert_allclose(transform[:, :2], expected, atol=0.02)
    np.testing.assert_allclose(transform[:, 2], [0.05, -0.02], atol=0.02)


def test_four_matches_are_no_evidence() -> None:
    source = scattered(1, 4)
    transform, inliers = verification.consensus(source, source)
    assert transform is None
    assert not inliers.any()


@pytest.mark.parametrize(("zoom", "turn"), [(1.0, np.pi / 2), (4.0, 0.0), (0.2, 0.0)])
def test_a_transform_that_turns_or_scales_too_much_is_no_evidence(zoom: float, turn: float) -> None:
    source = scattered(1, 20)
    transform, inliers = verification.consensus(source, moved(source, zoom, turn, (0.5, 0.1)))
    assert transform is None
    assert not inliers.any()


def test_keypoints_on_one_line_fix_no_transform() -> None:
    line = np.linspace(0.1, 0.7, 20, dtype=np.float32)[:, None] * np.ones((1, 2), np.float32)
    assert verification.consensus(line, line)[0] is None


def test_positions_that_coincide_propose_nothing() -> None:
    same = np.full((12, 2), 0.3, np.float32)
    assert verification.consensus(same, same)[0] is None


@settings(deadline=None)  # a busy machine is no failure
@given(st.integers(0, 2**16), st.floats(0.6, 1.7), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3))
def test_a_moved_image_keeps_its_keypoints(seed: int, zoom: float, turn: float, by: float) -> None:
    positions = scattered(seed, 30)
    query, view = features(positions, seed), features(moved(positions, zoom, turn, (by, -by)), seed)
    [found] = verification.verify(query, [view])
    assert found.matches == 30
    assert found.inliers == 30
    assert found.transform is not None
    there = found.pairs[:, :2] @ found.transform[:, :2].T + found.transform[:, 2]
    np.testing.assert_allclose(there, found.pairs[:, 2:], atol=verification.TOLERANCE)


@settings(deadline=None)  # a busy machine is no failure
@example(10599)  # two equally strong matches, but for rounding that depended on the number of views
@given(st.integers(0, 2**16))
def test_neither_chance_nor_the_other_views_change_a_verification(seed: int) -> None:
    query, view = features(scattered(seed, 25), seed), features(scattered(seed + 1, 25), seed)
    first, second = verification.verify(query, [view, view])
    assert (first.inliers, first.matches) == (second.inliers, second.matches)
    np.testing.assert_array_equal(first.pairs, second.pairs)
    [alone] = verification.verify(query, [view])
    np.testing.assert_array_equal(first.pairs, alone.pairs)


def test_only_what_stands_out_counts() -> None:
    # The median is 6: 14 is within 8 of it; 34 stands out by 20, softened by 6 + 20.
    bonus = verification.gated_bonus([6, 6, 14, 34, 2])
    np.testing.assert_allclose(bonus, [0, 0, 0, 20 / 46, 0])
    assert verification.gated_bonus([]).shape == (0,)
    # Three views of the right place, which counts once, and three others: the median is 6.
    bonus = verification.gated_bonus([34, 40, 31, 6, 6, 2], [34, 6, 6, 2])
    np.testing.assert_allclose(bonus, [20 / 46, 26 / 52, 17 / 43, 0, 0, 0])


@settings(deadline=None)  # a busy machine is no failure
@given(st.lists(st.integers(0, 300), min_size=1, max_size=12))
def test_the_bonus_lies_in_its_range_and_never_falls_with_the_count(inliers: list[int]) -> None:
    bonus = verification.gated_bonus(inliers)
    assert ((bonus >= 0) & (bonus < 1)).all()
    assert (np.diff(bonus[np.argsort(inliers)]) >= 0).all()
