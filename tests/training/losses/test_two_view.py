import math

import pytest
import torch

from training.losses.two_view import matched_cells, similarity_loss, two_view_loss


def test_the_loss_is_small_where_corresponding_cells_are_nearest() -> None:
    points = torch.eye(6).view(2, 3, 6)
    cells = torch.tensor([[0, 10, 20], [0, 10, 20]])

    right, accuracy = two_view_loss(points, points, cells, columns=32, temperature=0.07, margin=1)
    wrong, accuracy_when_wrong = two_view_loss(points, points.flip(0), cells, columns=32, temperature=0.07, margin=1)

    assert float(right) < 0.01
    assert float(wrong) > 10
    assert (float(accuracy), float(accuracy_when_wrong)) == (1.0, 0.0)


def test_neighbouring_cells_are_not_contrasted() -> None:
    same = torch.ones(1, 2, 4) / 2

    neighbours, _ = two_view_loss(same, same, torch.tensor([[0, 1]]), columns=32, temperature=0.07, margin=2)
    distant, _ = two_view_loss(same, same, torch.tensor([[0, 9]]), columns=32, temperature=0.07, margin=2)

    assert float(neighbours) == pytest.approx(0, abs=1e-6)
    assert float(distant) == pytest.approx(math.log(2), rel=1e-5)


def test_the_similarity_loss_is_zero_for_the_cosines_of_the_teacher() -> None:
    here, there = torch.eye(4).view(1, 4, 4), torch.eye(4).flip(0).view(1, 4, 4)

    assert float(similarity_loss(here, there, here, there)) == 0
    assert float(similarity_loss(here, there, here, here)) > 0


def test_matched_cells_are_read_where_the_views_show_them() -> None:
    field = torch.arange(12.0).view(1, 1, 3, 4).expand(2, 2, 3, 4).clone()
    field[:, 1] = 1
    cells = torch.tensor([[5, 11]])  # row 1 column 1, row 2 column 3
    positions = torch.tensor([[[-0.25, 0.0], [0.75, 2 / 3]]])  # the same cells' centres

    here, there = matched_cells(field, cells, positions)

    assert here.tolist() == [[[5.0, 1.0], [11.0, 1.0]]]
    assert torch.allclose(here, there, atol=1e-4)  # as they are: not scaled to unit length
