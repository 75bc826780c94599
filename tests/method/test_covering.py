import numpy as np

from worker.method.covering import covered


def test_cells_of_wanted_labels_and_those_that_are_nearly_so() -> None:
    scores = np.array([[[0.9, 0.1, 0.2], [0.30, 0.1, 0.36], [0.1, 0.2, 0.9], [0.5, 0.5, 0.1]]], np.float32)
    person = np.array([True, False, False])
    assert covered(scores, person, slack=0).tolist() == [[True, False, False, True]]
    assert covered(scores, person, slack=0.08).tolist() == [[True, True, False, True]]
    assert covered(scores, person, slack=2).all()


def test_no_label_and_every_label() -> None:
    scores = np.zeros((2, 3, 4), np.float32)
    assert not covered(scores, np.zeros(4, np.bool_)).any()
    assert covered(scores, np.ones(4, np.bool_)).all()
