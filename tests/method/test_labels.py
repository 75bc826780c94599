"""Equations 1 and 2 of the paper on hand-worked numbers."""

import numpy as np

from worker.method import labels

E = np.eye(3, dtype=np.float32)


def test_each_cell_takes_the_label_with_the_largest_inner_product() -> None:
    embeddings = np.array([[[1, 0, 0], [0.6, 0.8, 0]], [[0, 0.6, 0.8], [0, 1, 0]]], np.float32)

    scores = labels.scores(embeddings, E)

    np.testing.assert_allclose(scores[0, 1], [0.6, 0.8, 0])
    assert labels.label_map(scores).tolist() == [[0, 1], [2, 1]]


def test_a_tie_goes_to_the_lowest_label() -> None:
    scores = np.array([[[0.5, 0.7, 0.7]]], np.float32)
    assert labels.label_map(scores).tolist() == [[1]]


def test_shares_count_absent_labels_too() -> None:
    shares = labels.shares(np.array([[0, 0], [2, 0]], np.int16), count=4)
    assert shares.tolist() == [0.75, 0, 0.25, 0]
