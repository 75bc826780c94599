import numpy as np
import pytest
from hypothesis import given, strategies as st

from worker.method import hough
from worker.method.hough import Correspondences

SIZES = st.sampled_from((1.0, 1.0, 0.5, 0.77, 1.3))
"""Sides of a candidate's cells, in those of the query; mostly equal."""


def largest_weight(
    pairs: Correspondences,
    burstiness: np.ndarray,
    shape: tuple[int, int],
    cell_aspect: tuple[float, float] = (1.0, 1.0),
) -> float:
    """Weight of the heaviest window of the only candidate, by trying each displacement."""
    reach, heaviest = [side // 2 for side in shape], 0.0
    for zoom in hough.ZOOMS:
        centre = (np.array(shape) - 1) / 2
        ours, theirs = (
            np.stack(np.divmod(cell, shape[1]), axis=1) - centre for cell in (pairs.query_cell, pairs.candidate_cell)
        )
        moved = np.rint(np.array(cell_aspect) * theirs / np.sqrt(zoom) - ours * np.sqrt(zoom))
        weight = pairs.cosine.astype(np.float64) ** 2 * burstiness[pairs.query_cell]
        for down in range(-reach[0], reach[0] + 1):
            for across in range(-reach[1], reach[1] + 1):
                near = (np.abs(moved - [down, across]) <= hough.TOLERANCE).all(axis=1)
                heaviest = max(heaviest, weight[near].sum())
    return heaviest


@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 7), st.integers(1, 9)),
    cell_aspects=st.lists(st.tuples(SIZES, SIZES), min_size=1, max_size=3),
)
def test_the_score_is_that_of_the_heaviest_window_found_one_by_one(
    seed: int, shape: tuple[int, int], cell_aspects: list[tuple[float, float]]
) -> None:
    """Several candidates with the same pairs and cells of other sizes."""
    rng = np.random.default_rng(seed)
    cells = shape[0] * shape[1]
    taken = np.flatnonzero(rng.random(cells) < 0.7)
    theirs, cosine = rng.permutation(cells)[: len(taken)], rng.uniform(0.1, 1, len(taken)).astype(np.float32)
    burstiness = rng.uniform(0.1, 1, cells).astype(np.float32)

    def of(candidates: int) -> Correspondences:
        candidate = np.repeat(np.arange(candidates), len(taken))
        return Correspondences(
            candidate, np.tile(taken, candidates), np.tile(theirs, candidates), np.tile(cosine, candidates)
        )

    some = len(cell_aspects)
    found = hough.agreement(of(some), burstiness, shape, some, cell_aspect=np.array(cell_aspects))

    heaviest = [largest_weight(of(1), burstiness, shape, cell_aspect) for cell_aspect in cell_aspects]
    assert found.scores == pytest.approx(np.sqrt(np.minimum(1, heaviest / burstiness.sum())), abs=1e-6)
    [plain] = hough.agreement(of(1), burstiness, shape, 1).scores
    assert all(
        score == plain
        for score, cell_aspect in zip(found.scores, cell_aspects, strict=True)
        if cell_aspect == (1.0, 1.0)
    )


def test_images_of_one_shape_have_cell_aspect_1_and_an_upright_one_has_narrow_and_high_cells() -> None:
    landscape, upright, square = (1.0, 0.75), (0.75, 1.0), (1.0, 1.0)
    assert hough.cell_aspects(landscape, [landscape, (1.0, 0.76), square]).tolist()[:2] == [[1.0, 1.0]] * 2
    [[height, width]] = hough.cell_aspects(landscape, [upright])
    assert height == pytest.approx(4 / 3, rel=0.05)
    assert width == pytest.approx(3 / 4, rel=0.05)
    assert hough.cell_aspects(upright, [landscape]) == pytest.approx(1 / np.array([[height, width]]))
    assert hough.cell_aspects(square, []).shape == (0, 2)


@given(height=st.integers(3, 9), width=st.integers(3, 9))
def test_the_cell_aspect_aligns_an_upright_grid_with_a_landscape_one(height: int, width: int) -> None:
    """Every cell of an upright grid corresponds to the cell of a landscape grid at the same place in the world."""
    shape = (2 * height + 1, 2 * width + 1)
    rows, columns = (np.arange(side) - side // 2 for side in shape)
    # The candidate's cells are twice as wide, so what the query shows lies in its middle half.
    across = np.rint(columns / 2).astype(int) + shape[1] // 2
    ours = np.arange(shape[0] * shape[1])
    theirs = (np.repeat(rows + shape[0] // 2, shape[1]) * shape[1] + np.tile(across, shape[0])).astype(np.intp)
    pairs = Correspondences(np.zeros(len(ours), np.intp), ours, theirs, np.ones(len(ours), np.float32))
    found = hough.agreement(pairs, np.ones(len(ours), np.float32), shape, 1, cell_aspect=np.array([[1.0, 2.0]]))
    assert found.scores[0] == pytest.approx(1.0)
    assert found.shifts.tolist() == [[0, 0]]
    assert found.scales[0] == pytest.approx(1.0, abs=0.1)


def test_a_map_of_many_shapes_needs_one_table_of_votes() -> None:
    """One table per shape would be made anew in most queries, and take ten times as long as the rest."""
    nothing = np.zeros(0, np.intp)
    pairs = Correspondences(nothing, nothing, nothing, np.zeros(0, np.float32))
    shapes = hough.cell_aspects((1.0, 0.75), [(1.0, height / 50) for height in range(5, 51)])
    before = hough._slots.cache_info().misses
    hough.agreement(pairs, np.ones(35, np.float32), (5, 7), len(shapes), cell_aspect=shapes)
    assert hough._slots.cache_info().misses <= before + 1
