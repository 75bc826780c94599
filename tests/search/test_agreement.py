"""N-consistency: which images in a row come back to one stretch of the map."""

from collections.abc import Sequence
from itertools import pairwise

from hypothesis import given, strategies as st

from worker.service.agreement import REACH, Row


def rows(orders: Sequence[int | None]) -> list[int]:
    """How many images agree after each."""
    row, counts = Row(), []
    for order in orders:
        row = row.followed_by(order)
        counts.append(row.images)
    return counts


def test_an_image_that_stands_alone_begins_anew() -> None:
    assert rows([None, 3, None, 40, 41, 43, 44, 9, None, 9]) == [0, 1, 0, 1, 2, 3, 4, 1, 0, 1]


def test_a_way_may_be_driven_backwards_fast_and_with_stops() -> None:
    assert rows([44, 44, 42, 42 - REACH]) == [1, 2, 3, 4]
    assert rows([44, 44 - REACH - 1]) == [1, 1]


@given(st.lists(st.none() | st.integers(0, 30)))
def test_a_row_is_the_longest_that_ends_with_the_last_image(orders: list[int | None]) -> None:
    for end, count in enumerate(rows(orders)):
        row = orders[end + 1 - count : end + 1]
        assert None not in row
        assert all(abs(b - a) <= REACH for a, b in pairwise(row))  # type: ignore[operator]
        before = orders[end - count] if count and end >= count else None
        assert count == 0 or before is None or abs(before - row[0]) > REACH  # type: ignore[operator]
