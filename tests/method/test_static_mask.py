"""The mask of static cells: by the paper's rule, by a margin, and with a bounded share."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from worker.method.labels import label_map
from worker.method.static_mask import static_cells

SCORES = np.array([[[0.9, 0.1], [0.4, 0.5], [0.1, 0.8], [0.5, 0.5]]], np.float32)
CAR = np.array([False, True])


def test_the_papers_rule_drops_every_cell_whose_label_is_dynamic() -> None:
    assert static_cells(SCORES, CAR).tolist() == [[True, False, False, True]]  # a tie goes to the lower label


def test_with_a_margin_only_the_sure_cells_go() -> None:
    assert static_cells(SCORES, CAR, margin=0.3).tolist() == [[True, True, False, True]]


def test_never_more_than_the_allowed_share_goes_and_the_surest_first() -> None:
    assert static_cells(SCORES, CAR, most=0.25).tolist() == [[True, True, False, True]]
    assert static_cells(SCORES, CAR, most=0.0).all()


def test_an_image_of_nothing_but_cars_has_no_static_content_whatever_the_preset_spares() -> None:
    only_cars = np.array([[[0.1, 0.8], [0.45, 0.5]]], np.float32)
    assert not static_cells(only_cars, CAR, margin=0.9, most=0.1).any()


def test_without_dynamic_labels_everything_stays() -> None:
    assert static_cells(SCORES, np.array([False, False])).all()


@given(
    arrays(np.float32, (4, 5, 6), elements=st.floats(-1, 1, width=32)),
    arrays(np.bool_, 6),
    st.floats(0, 2),
    st.floats(0, 1),
)
def test_masked_cells_have_dynamic_labels_and_their_share_is_bounded(
    scores: np.ndarray, dynamic: np.ndarray, margin: float, most: float
) -> None:
    kept = static_cells(scores, dynamic, margin, most)
    moving = dynamic[label_map(scores)]

    assert not (~kept & ~moving).any()
    if not moving.all():
        assert (~kept).sum() <= most * kept.size
