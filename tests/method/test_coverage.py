"""Spots, directions and gaps of a map, against hand-worked numbers."""

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from worker.method.coverage import gaps, missing_directions, spots


def test_points_near_the_first_of_a_spot_are_of_it() -> None:
    line = np.array([[0.0, 0], [4, 0], [5, 0], [9, 0], [-5, 0], [5.5, 0]])
    assert spots(line, 5.0) == [[0, 1, 2, 4], [3, 5]]
    assert spots(line, 0.0) == [[i] for i in range(6)]
    assert spots(np.zeros((0, 2)), 5.0) == []
    up = np.array([[0.0, 0, 0], [3, 0, 3], [3, 0, 4], [0, 0, 5.1]])
    assert spots(up, 5.0) == [[0, 1, 2], [3]]


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), max_size=30), st.floats(0, 20))
@example([(0.0, 1.0), (0.0, -1e-249)], 1.0)
def test_every_point_is_in_one_spot_and_near_its_first(points: list[tuple[float, float]], within: float) -> None:
    array = np.array(points, np.float64).reshape(-1, 2)
    found = spots(array, within)
    assert sorted(i for spot in found for i in spot) == list(range(len(points)))
    for first, *others in found:
        assert all(np.hypot(*(array[i] - array[first])) <= within for i in others)
    firsts = [spot[0] for spot in found]
    assert all(np.hypot(*(array[b] - array[a])) > within for a in firsts for b in firsts if a < b)


@pytest.mark.parametrize(
    ("headings", "missing"),
    [
        ([], []),
        ([10], ["east", "south", "west"]),
        ([45, 225], []),
        ([350, 170], ["east", "west"]),
        ([0, 120, 240], []),
    ],
)
def test_a_direction_is_missing_that_no_view_looks_near(headings: list[float], missing: list[str]) -> None:
    assert missing_directions(headings) == missing


def test_a_gap_is_much_longer_than_the_usual_step_whatever_the_order() -> None:
    way = np.array([[x, 0.0] for x in (0, 10, 20, 30, 100, 110, 120)])
    assert gaps(way, 20) == [(3, 4, 70.0)]
    shuffled = way[[4, 0, 6, 2, 3, 1, 5]]
    assert [length for *_, length in gaps(shuffled, 20)] == [70.0]
    assert gaps(way, 80) == []
    assert gaps(way[:2], 0) == []
    assert gaps(np.array([[0.0, 0, z] for z in (0, 10, 20, 100)]), 20) == [(2, 3, 80.0)]
