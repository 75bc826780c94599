import numpy as np
import pytest

from training.data.viewpoint import DETAIL_RANGE, LABELLED_RANGE, SEMANTIC_RANGE, ViewRange, draw_views, shared_cells


@pytest.mark.parametrize("view_range", [SEMANTIC_RANGE, DETAIL_RANGE])
@pytest.mark.parametrize("seed", range(4))
def test_shared_cells_show_the_same_point_of_the_source(view_range: ViewRange, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:360, :480]
    source = np.stack([columns / 2, rows / 2, np.zeros_like(rows)], axis=2).astype(np.uint8)  # says where it is

    first, second = draw_views((360, 480), (192, 256), view_range, rng)
    cells, positions, enough = shared_cells(first, second, (24, 32), 50, rng)

    assert enough
    one, other = (view.cut(source, (192, 256), labels=False).astype(int) for view in (first, second))
    for cell, (x, y) in zip(cells, positions, strict=True):
        here = one[cell // 32 * 8 + 4, cell % 32 * 8 + 4]
        there = other[int((y + 1) * 96), int((x + 1) * 128)]
        assert np.abs(here - there).max() <= 4


def test_labels_outside_the_source_say_nothing() -> None:
    rng = np.random.default_rng(0)
    labels = np.zeros((200, 260), np.uint8)
    seen = set()
    for _ in range(20):
        view, _ = draw_views(labels.shape, (192, 256), DETAIL_RANGE, rng)
        seen |= set(np.unique(view.cut(labels, (192, 256), labels=True)).tolist())

    assert seen == {0, 255}


def test_a_view_is_enlarged_as_told_and_more_where_the_source_would_not_fill_it() -> None:
    rng = np.random.default_rng(0)

    def shares(zoom: tuple[float, float], size: tuple[int, int]) -> list[float]:
        """Of the source's area that views show, which leaning changes a little."""
        drawn = [draw_views((360, 480), size, LABELLED_RANGE, rng, zoom)[0].to_source for _ in range(40)]
        corners = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]]).T
        seen = [(matrix @ corners)[:2] / (matrix @ corners)[2] for matrix in drawn]
        return [abs(float(np.linalg.det(np.stack([at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]])))) for at in seen]

    close = shares((2.0, 2.0), (192, 256))
    assert np.median(close) == pytest.approx((192 / 720) * (256 / 960), rel=0.1)
    assert np.median(shares((0.1, 0.1), (192, 256))) > 0.9
