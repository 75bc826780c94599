"""How many images are sent, and which."""

from itertools import pairwise

import pytest
from hypothesis import given, strategies as st
from revisit_ros.pacing import HandOver, Pace, Stride, Waiting


def test_so_many_a_second() -> None:
    pace = Pace(2)
    taken = []
    for tick in range(30):  # images at 10 a second
        if pace.due(tick / 10):
            pace.take(tick / 10)
            taken.append(tick)
    assert taken == [0, 5, 10, 15, 20, 25]


def test_a_rate_of_zero_waits_for_triggers() -> None:
    pace = Pace(0)
    assert not pace.due(0)
    pace.triggered = True
    assert pace.due(0)
    pace.take(0)
    assert not pace.due(1e9)


def test_a_trigger_comes_out_of_turn_once() -> None:
    pace = Pace(1)
    pace.take(0)
    assert not pace.due(0.5)
    pace.triggered = True
    assert pace.due(0.5)
    pace.take(0.5)
    assert not pace.due(1.4)
    assert pace.due(1.5)


@given(st.floats(0.1, 30), st.lists(st.floats(0, 0.5), max_size=200))
def test_never_more_than_the_rate(rate: float, steps: list[float]) -> None:
    pace, now, taken = Pace(rate), 0.0, []
    for step in steps:
        now += step
        if pace.due(now):
            pace.take(now)
            taken.append(now)
    assert all(later - earlier >= (1 / rate) * (1 - 1e-6) for earlier, later in pairwise(taken))


@given(st.integers(1, 5), st.lists(st.sampled_from(["put", "take", "back"]), max_size=60))
def test_what_waits_is_the_newest_and_nothing_is_lost_unseen(most: int, steps: list[str]) -> None:
    waiting: Waiting[int] = Waiting(most)
    put = taken = 0
    last = -1
    for step in steps:
        if step == "put":
            waiting.put(put)
            put += 1
        else:
            peeked, item = waiting.peek(), waiting.take()
            assert peeked == item
            if item is None:
                continue
            assert item > last
            if step == "back":
                waiting.put_back(item)
            else:
                taken, last = taken + 1, item
        assert len(waiting) <= most
    assert put == taken + len(waiting) + waiting.dropped


def test_the_oldest_gives_way() -> None:
    waiting: Waiting[str] = Waiting(1)
    waiting.put("first")
    waiting.put("second")
    assert (waiting.take(), waiting.take(), waiting.dropped) == ("second", None, 1)
    waiting.put("third")
    waiting.put_back("older")
    assert (waiting.take(), waiting.dropped) == ("third", 2)


def test_every_metre_or_half_turn() -> None:
    stride = Stride(1, 45)
    assert stride.far_enough((0, 0, 0), 350)
    stride.take((0, 0, 0), 350)
    assert not stride.far_enough((0.6, 0.6, 0), 350)  # 0.85 m
    assert stride.far_enough((0.6, 0.8, 0), 350)
    assert stride.far_enough((0, 0, 1), 350)
    assert not stride.far_enough((0, 0, 0), 30)  # 40 degrees, over north
    assert stride.far_enough((0, 0, 0), 35)
    assert stride.far_enough((0, 0, 0), 305)
    assert not stride.far_enough((0, 0, 0), None)


def test_turns_need_not_count() -> None:
    stride = Stride(1, 0)
    stride.take((0, 0, 0), 0)
    assert not stride.far_enough((0, 0, 0), 180)


@pytest.mark.parametrize("every", [False, True])
def test_the_first_pose_and_the_first_after_a_trigger(every: bool) -> None:
    hand = HandOver(every)
    assert hand.wanted
    hand.handed()
    assert hand.wanted is every
    hand.triggered()
    assert hand.wanted
