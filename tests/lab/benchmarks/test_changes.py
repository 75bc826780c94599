"""Changes are judged against what was taken away, put and moved in drawn places."""

import numpy as np
import pytest

from lab.benchmarks.changes import Tally, Truth, judge, refurnished
from worker.method.changes import Change, Changes, Kind
from worker.method.lost_regions import Spot


def box(left: int) -> np.ndarray:
    mask = np.zeros((48, 64), np.uint8)
    mask[16:32, left : left + 16] = 1
    return mask


def spot(left: int) -> Spot:
    return Spot((0.0, 0.0), (0.0, 0.0), 0.0, box(left) > 0)


def change(kind: Kind, then: Spot | None, now: Spot | None) -> Change:
    return Change(kind, 0, None, 0.9, then, now)


def judged(changes: list[Change] | None, *truth: Truth) -> Tally:
    tally = Tally()
    judge(None if changes is None else Changes(tuple(changes), 1.0, 0.9), truth, tally)
    return tally


def test_what_is_gone_counts_where_it_stood() -> None:
    gone = Truth("gone", box(8), None)

    right = judged([change("gone", spot(10), None)], gone)
    assert (right.sites, right.right, right.wrong, right.recall, right.precision) == (1, 1, 0, 1, 1)
    elsewhere = judged([change("gone", spot(40), None)], gone)
    assert (elsewhere.right, elsewhere.wrong, elsewhere.recall) == (0, 1, 0)
    later = judged([change("new", None, spot(8))], gone)
    assert (later.right, later.wrong) == (0, 1)


def test_a_thing_that_moved_has_two_sites() -> None:
    moved = Truth("moved", box(4), box(40))

    both = judged([change("moved", spot(4), spot(40))], moved)
    assert (both.sites, both.right, both.moved, both.moved_found) == (2, 2, 1, 1)
    apart = judged([change("gone", spot(4), None), change("new", None, spot(40))], moved)
    assert (apart.sites, apart.right, apart.moved_found) == (2, 2, 0)


def test_pairs_that_cannot_be_aligned_find_nothing() -> None:
    missed = judged(None, Truth("new", None, box(8)))

    assert (missed.pairs, missed.aligned, missed.sites, missed.recall) == (1, 0, 1, 0)


@pytest.mark.parametrize("seed", range(4))
def test_a_refurnished_place_is_the_same_each_time(seed: int) -> None:
    then, now, truth = refurnished(seed)
    again = refurnished(seed)

    assert np.array_equal(then, again[0])
    assert np.array_equal(now, again[1])
    for one, other in zip(truth, again[2], strict=True):
        assert one.kind == other.kind
        assert (one.then is None, one.now is None) == {
            "gone": (False, True),
            "new": (True, False),
            "moved": (False, False),
        }[one.kind]
