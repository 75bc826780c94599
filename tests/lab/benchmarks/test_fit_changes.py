"""The confidence of changes is fitted to regions of drawn places, and what moved is counted."""

import numpy as np
import pytest

from lab.benchmarks.changes import Truth
from lab.benchmarks.fit_changes import Example, Pair, fit, moved, moved_pieces
from worker.method.lost_regions import WEIGHTS, Region, Spot
from worker.method.unit_length import unit

SAME = np.array([[1.0, 0, 0], [0, 1, 0]])
SURE = dict(zip(WEIGHTS, (-3.0, 0.7, 0.3, 0.0), strict=True))
DOUBTFUL = dict(zip(WEIGHTS, (-3.2, 0.42, 0.02, 0.0), strict=True))
MASK = np.ones((48, 64), np.uint8)


def region(features: dict[str, float], left: float = 0.2, kind: int = 0) -> Region:
    """A region of cells of one kind on a floor of another."""
    look = unit(np.eye(8, dtype=np.float32)[[kind] * 6] + 0.01)
    floor = unit(np.eye(8, dtype=np.float32)[[7] * 6] + 0.01)
    return Region(Spot((left, 0.5), (0.1, 0.1), 0.02, np.ones((4, 4), np.bool_)), 0, 0, features, look, floor)


def pair(gone: list[Example], new: list[Example], *truth: Truth) -> Pair:
    return Pair(gone, new, truth, SAME, 0.9)


def test_what_speaks_for_a_change_weighs_for_it_and_a_border_against_it() -> None:
    draw = np.random.default_rng(3)

    def some(right: bool) -> Example:
        features = dict(zip(WEIGHTS, draw.normal((-3, 0.5, 0.1, 0.2), (0.6, 0.1, 0.05, 0.1)), strict=True))
        features["contrast"] += 0.2 * right
        features["border"] += 0.2 * (not right)
        return Example(region(features), 0 if right else None, True)

    found = [some(bool(number % 2)) for number in range(400)]
    unclear = Example(region(SURE), None, False)
    fitted = fit([pair([*found, unclear], [])])
    assert (fitted.right, fitted.wrong) == (200, 200)
    assert fitted.weights["contrast"] > 0 > fitted.weights["border"]
    assert fit([pair(found, [])]) == fit([pair(found[:100], found[100:])])
    with pytest.raises(ValueError, match="wrong"):
        fit([pair([some(False)], [some(False)])])


def test_two_ends_are_one_thing_that_moved_where_they_look_alike() -> None:
    truth = Truth("moved", MASK, MASK)
    ends = Example(region(SURE), 0, True), Example(region(DOUBTFUL, left=0.8), 0, True)
    assert moved([pair([ends[0]], [ends[1]], truth)], 0.2) == (1, 0)
    other = Example(region(DOUBTFUL, left=0.8, kind=3), 0, True)
    assert moved([pair([ends[0]], [other], truth)], 0.2) == (0, 0)
    doubtful = Example(region(DOUBTFUL), 0, True)
    assert moved([pair([doubtful], [ends[1]], truth)], 0.2) == (0, 0)  # neither is sure
    another = Example(region(SURE, left=0.8), None, True)
    assert moved([pair([ends[0]], [another], truth)], 0.2) == (0, 1)
    assert moved_pieces([pair([], [], truth, Truth("gone", MASK, None))]) == 1
