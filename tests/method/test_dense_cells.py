"""Dense cells, their correspondences, and the similarity."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from schemas.description import Floats
from schemas.errors import DescriptorMismatch
from worker.method import dense_cells, hough
from worker.method.byte_vectors import quantise


def cells(seed: int, rows: int = 8, columns: int = 12, channels: int = 16) -> Floats:
    drawn = np.random.default_rng(seed).normal(size=(rows, columns, channels)).astype(np.float32)
    unit: Floats = drawn / np.linalg.norm(drawn, axis=2, keepdims=True)
    return unit


def test_a_cell_is_the_mean_of_its_pixels_less_the_mean_of_the_image() -> None:
    east, north = (1.0, 0.0), (0.0, 1.0)
    field = np.array([[east, east, north, north]], np.float32)
    # Cell means are (1, 0) and (0, 1), the image's mean (.5, .5): (.5, -.5) and (-.5, .5) before scaling.
    half = np.sqrt(0.5)
    np.testing.assert_allclose(dense_cells.grid(field, 1, 2), [[[half, -half], [-half, half]]], atol=1e-6)


def test_pixels_on_the_border_of_two_cells_count_for_both_by_their_share() -> None:
    # Three pixels in two cells: the middle one belongs half to each, so the cells are (2/3, 1/3) and (1/3, 2/3) of it.
    field = np.array([[[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]], np.float32)
    left, right = np.array([2, 1, 0]) / np.sqrt(5), np.array([0, 1, 2]) / np.sqrt(5)
    mean = (left + right) / 2
    expected = np.stack([(left - mean) / np.linalg.norm(left - mean), (right - mean) / np.linalg.norm(right - mean)])
    np.testing.assert_allclose(dense_cells.grid(field, 1, 2)[0], expected, atol=1e-6)


def test_a_field_smaller_than_the_grid_repeats_its_pixels() -> None:
    field = cells(3, rows=2, columns=2)
    grid = dense_cells.grid(field, 4, 4)
    np.testing.assert_allclose(grid[0, 0], grid[1, 1], atol=1e-6)


def test_an_image_of_one_colour_has_no_direction_and_matches_nothing() -> None:
    plain = dense_cells.grid(np.full((6, 6, 4), 0.5, np.float32), 3, 3)
    assert np.isfinite(plain).all()
    nothing = np.zeros((3, 3, 4), np.int8)
    found = dense_cells.compare(nothing, nothing[None])
    assert found.scores.tolist() == [0.0]
    assert found.shifts.tolist() == [[0, 0]]
    assert found.scales.tolist() == [1.0]


def test_storage_is_one_byte_a_component() -> None:
    reduced = dense_cells.reduce(np.array([[[3.0, 4.0, 0.0]]], np.float32), np.eye(3, 2, dtype=np.float32))
    np.testing.assert_allclose(reduced, [[[0.6, 0.8]]], atol=1e-6)
    stored = quantise(reduced)
    assert stored.dtype == np.int8
    assert stored.tolist() == [[[76, 102]]]  # 127 x (.6, .8)


def test_the_cosine_of_joined_cells_is_the_mean_of_the_channels() -> None:
    one = {"words": cells(0, channels=8), "detail": cells(1, channels=16), "heat": cells(4, channels=4)}
    other = {"words": cells(2, channels=8), "detail": cells(3, channels=16), "heat": cells(5, channels=4)}
    cosine = {name: (one[name] * other[name]).sum(axis=2) for name in one}
    joined = [dense_cells.join(each, {"words": 0.1, "detail": 0.3}) for each in (one, other)]
    expected = 0.25 * cosine["words"] + 0.75 * cosine["detail"]
    np.testing.assert_allclose((joined[0] * joined[1]).sum(axis=2), expected, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(joined[0], axis=2), 1, atol=1e-6)
    alike = [dense_cells.join(each, {}) for each in (one, other)]
    np.testing.assert_allclose((alike[0] * alike[1]).sum(axis=2), sum(cosine.values()) / 3, atol=1e-6)


def test_a_channel_that_is_missing_leaves_the_others_scaled_up() -> None:
    words = cells(0)
    np.testing.assert_allclose(dense_cells.join({"words": words}, {"words": 0.25, "detail": 0.75}), words)
    assert dense_cells.join({}, {"words": 1.0}).size == 0


def test_another_number_of_channels_is_refused() -> None:
    with pytest.raises(DescriptorMismatch):
        dense_cells.reduce(cells(0), np.eye(4, dtype=np.float32))
    with pytest.raises(DescriptorMismatch):
        dense_cells.compare(cells(0), cells(0, channels=4)[None])


def test_another_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be compared"):
        dense_cells.compare(cells(0), cells(0, rows=4)[None])


def test_half_as_many_rows_and_columns_without_an_odd_rest() -> None:
    halved = dense_cells.halve(cells(1, rows=5, columns=4))
    assert halved.shape == (2, 2, 16)
    whole = cells(1, rows=5, columns=4)
    mean = whole[:2, :2].mean(axis=(0, 1))
    np.testing.assert_allclose(halved[0, 0], mean / np.linalg.norm(mean), atol=1e-5)


def test_correspondences_are_mutual_and_the_first_of_equals_wins() -> None:
    query = np.array([[[1, 0], [0, 1]]], np.float32)
    candidate = np.array([[[1, 0], [1, 0]]], np.float32)
    pairs = dense_cells.correspondences(query, candidate[None])
    # Both candidate cells are nearest to query cell 0, which matches the first. Query cell 1 has no cosine above 0.
    assert pairs.query_cell.tolist() == [0]
    assert pairs.candidate_cell.tolist() == [0]
    assert pairs.cosine.tolist() == [1.0]


def test_the_weight_is_the_squared_cosine_of_those_that_agree() -> None:
    pairs = hough.Correspondences(
        candidate=np.array([0, 0, 0]),
        query_cell=np.array([0, 1, 2]),  # row 0, columns 0, 1, 2
        candidate_cell=np.array([1, 2, 19]),  # columns 1 and 2; row 1, column 9
        cosine=np.array([1.0, 0.5, 1.0], np.float32),
    )
    found = hough.agreement(pairs, np.ones(20, np.float32), (2, 10), 1)
    # The first two move one column to the right: (1 + .25) / 20 cells; the third moves elsewhere.
    np.testing.assert_allclose(found.scores, [np.sqrt(1.25 / 20)])
    assert found.shifts.tolist() == [[0, 1]]


def test_a_cell_that_recurs_far_away_has_burstiness_weight_0() -> None:
    # Columns: a, b, c, a, d with d halfway (cosine .6) between b and something else; neighbours do not count.
    a, b, c, d = np.eye(5)[0], np.eye(5)[1], np.eye(5)[2], 0.6 * np.eye(5)[1] + 0.8 * np.eye(5)[4]
    burstiness = dense_cells.burstiness_weight(np.array([[a, b, c, a, d]], np.float32))
    np.testing.assert_allclose(burstiness, [0, 0.4, 1, 0, 0.4], atol=1e-6)
    np.testing.assert_allclose(dense_cells.burstiness_weight(np.array([[a, b, c]], np.float32)), [1, 1, 1])


def test_votes_are_weighted_by_the_burstiness_weight() -> None:
    pairs = hough.Correspondences(
        candidate=np.array([0, 1]),
        query_cell=np.array([0, 1]),
        candidate_cell=np.array([0, 1]),
        cosine=np.ones(2, np.float32),
    )
    found = hough.agreement(pairs, np.array([0.25, 0.75], np.float32), (1, 2), 2)
    np.testing.assert_allclose(found.scores, np.sqrt([0.25, 0.75]), atol=1e-6)


def test_an_image_has_similarity_1_with_itself() -> None:
    own = cells(5)
    found = dense_cells.compare(own, np.stack([own, cells(6)]))
    assert found.scores[0] == pytest.approx(1, abs=1e-5)
    assert found.shifts[0].tolist() == [0, 0]
    assert found.scales[0] == 1
    assert found.scores[1] < 0.6


def test_a_step_forward_is_found_as_a_zoom() -> None:
    wide = cells(7, rows=24, columns=30)
    rows = np.rint((np.arange(24) - 11.5) / 1.25 + 11.5).astype(int)
    columns = np.rint((np.arange(30) - 14.5) / 1.25 + 14.5).astype(int)
    near = wide[rows][:, columns]
    pairs = dense_cells.correspondences(wide, np.stack([near, wide]))
    burstiness = np.ones(720, np.float32)
    assert hough.winning(pairs, burstiness, (24, 30), 2, np.ones((2, 2))).zooms.tolist() == [1.25, 1.0]
    found = hough.agreement(pairs, burstiness, (24, 30), 2)
    assert found.scales[0] == pytest.approx(1.25, abs=0.03)
    assert found.scales[1] == 1
    without = hough.agreement(pairs, burstiness, (24, 30), 2, estimate_scales=False)
    assert without.scales.tolist() == [1, 1]
    assert without.scores.tolist() == found.scores.tolist()


@settings(deadline=None)  # a busy machine is no failure
@given(st.floats(0.8, 1.25), st.integers(-3, 3), st.integers(2, 300))
def test_a_scale_is_measured_whatever_the_shift_and_pulled_towards_one_when_few_cells_tell_it(
    scale: float, across: int, count: int
) -> None:
    draw = np.random.default_rng(0)
    shape = (40, 60)
    row, column = draw.integers(5, 35, count), draw.integers(5, 55, count)
    there = np.rint((row - 19.5) * scale + 19.5) * 60 + np.rint((column - 29.5) * scale + 29.5 + across)
    everywhere = np.zeros(count, np.intp)
    pairs = hough.Correspondences(everywhere, row * 60 + column, there.astype(np.intp), np.ones(count, np.float32))
    found = hough.agreement(pairs, np.ones(2400, np.float32), shape, 1)

    measured = float(found.scales[0])
    assert min(scale, 1) - 0.05 <= measured <= max(scale, 1) + 0.05
    if count >= 100:
        assert measured == pytest.approx(scale, abs=0.05)


def test_a_similarity_counts_less_the_more_the_scale_differs_either_way() -> None:
    near = dense_cells.scale_penalty(np.array([1.0, 1.25, 0.8, 2.0], np.float32), 0.5)
    np.testing.assert_allclose(near, [1, np.sqrt(0.8), np.sqrt(0.8), np.sqrt(0.5)], rtol=1e-6)
    assert dense_cells.scale_penalty(np.array([0.5], np.float32), 0.0).tolist() == [1.0]


@settings(deadline=None)  # a busy machine is no failure
@given(st.integers(0, 2**16), st.integers(-3, 3), st.integers(-4, 4))
def test_a_shift_is_found_whatever_it_is(seed: int, down: int, across: int) -> None:
    large = cells(seed, rows=20, columns=24, channels=24)
    query, moved = large[6:14, 6:18], large[6 - down : 14 - down, 6 - across : 18 - across]
    pairs = dense_cells.correspondences(query, moved[None])
    found = hough.agreement(pairs, np.ones(96, np.float32), (8, 12), 1)
    assert found.shifts.tolist() == [[down, across]]
    assert found.scores[0] ** 2 >= (8 - abs(down)) * (12 - abs(across)) / 96 - 0.1


@settings(deadline=None)  # a busy machine is no failure
@given(st.integers(0, 2**16), st.integers(0, 3))
def test_scores_lie_in_their_range_and_do_not_depend_on_the_other_candidates(seed: int, count: int) -> None:
    query = cells(seed)
    candidates = np.stack([cells(seed + 1 + i) for i in range(count)]) if count else query[None][:0]
    found = dense_cells.compare(query, candidates)
    assert found.scores.shape == found.scales.shape == (count,)
    assert found.shifts.shape == (count, 2)
    assert ((found.scores >= 0) & (found.scores <= 1)).all()
    assert ((found.scales >= 0.5) & (found.scales <= 2)).all()
    for i in range(count):
        alone = dense_cells.compare(query, candidates[i : i + 1])
        np.testing.assert_allclose(alone.scores[0], found.scores[i], atol=1e-6)
        np.testing.assert_allclose(alone.scales[0], found.scales[i], atol=1e-6)
