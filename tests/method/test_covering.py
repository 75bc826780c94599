import numpy as np

from worker.method.covering import covered


def test_cells_of_wanted_labels_and_those_that_are_nearly_so() -> None:
    scores = np.array([[[0.9, 0.1, 0.2], [0.30, 0.1, 0.37], [0.30, 0.1, 0.39], [0.5, 0.5, 0.1]]], np.float32)
    assert covered(scores, np.array([True, False, False])).tolist() == [[True, True, False, True]]


def test_no_label_and_every_label() -> None:
    scores = np.zeros((2, 3, 4), np.float32)
    assert not covered(scores, np.zeros(4, np.bool_)).any()
    assert covered(scores, np.ones(4, np.bool_)).all()
