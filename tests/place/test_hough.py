import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worker.place import hough
from worker.place.hough import Correspondences


def largest_weight(pairs: Correspondences, distinct: np.ndarray, shape: tuple[int, int], tolerance: int) -> float:
    """The heaviest window of the only candidate, displacement by displacement, as the equations have it."""
    reach, heaviest = [side // 2 for side in shape], 0.0
    for zoom in hough.ZOOMS:
        centre = (np.array(shape) - 1) / 2
        ours, theirs = (
            np.stack(np.divmod(cell, shape[1]), axis=1) - centre for cell in (pairs.query_cell, pairs.candidate_cell)
        )
        moved = np.rint(theirs / np.sqrt(zoom) - ours * np.sqrt(zoom))
        weight = pairs.cosine.astype(np.float64) ** 2 * distinct[pairs.query_cell]
        for down in range(-reach[0], reach[0] + 1):
            for across in range(-reach[1], reach[1] + 1):
                near = (np.abs(moved - [down, across]) <= tolerance).all(axis=1)
                heaviest = max(heaviest, weight[near].sum())
    return heaviest


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 7), st.integers(1, 9)),
    tolerance=st.integers(0, 3),
)
def test_the_score_is_that_of_the_heaviest_window_found_one_by_one(
    seed: int, shape: tuple[int, int], tolerance: int
) -> None:
    rng = np.random.default_rng(seed)
    cells = shape[0] * shape[1]
    taken = np.flatnonzero(rng.random(cells) < 0.7)
    pairs = Correspondences(
        np.zeros(len(taken), np.intp),
        taken,
        rng.permutation(cells)[: len(taken)],
        rng.uniform(0.1, 1, len(taken)).astype(np.float32),
    )
    distinct = rng.uniform(0.1, 1, cells).astype(np.float32)

    found = hough.agreement(pairs, distinct, shape, 1, tolerance=tolerance)

    expected = np.sqrt(min(1, largest_weight(pairs, distinct, shape, tolerance) / distinct.sum()))
    assert found.scores[0] == pytest.approx(expected, abs=1e-6)
