import math

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.losses.label_loss import WordLoss
from training.losses.two_view import matched_cells, similarity_loss, two_view_loss


def one_pixel(x: float, y: float, z: float) -> torch.Tensor:
    return torch.tensor([x, y, z], dtype=torch.float32).view(1, 3, 1, 1)


def loss_over_three_words(members: list[list[bool]], known: list[bool]) -> WordLoss:
    allowed = torch.tensor(members)
    return WordLoss(torch.eye(3), allowed, torch.tensor([known] * len(members)), torch.ones(len(members)), 0.5)


def plain_head() -> nn.Conv2d:
    """A words head that hands on what it reads."""
    head = nn.Conv2d(3, 3, 1)
    head.load_state_dict({"weight": torch.eye(3)[:, :, None, None], "bias": torch.zeros(3)})
    return head.requires_grad_(False)


def by_definition(loss: WordLoss, embeddings: Tensor, meanings: Tensor, sets: Tensor) -> Tensor:
    """The word loss pixel by pixel, from embeddings (n, channels, h, w) and meanings (n, h, w)."""
    total, weights = torch.zeros(()), torch.zeros(())
    for number, row, column in (meanings >= 0).nonzero().tolist():
        meaning, data_set = int(meanings[number, row, column]), int(sets[number])
        if data_set < 0:
            continue
        scores = (loss.vectors @ F.normalize(embeddings[number, :, row, column], dim=0) / loss.temperature).exp()
        likely = scores[loss.members[meaning] == 0].sum() / scores[loss.known[meaning]].sum()
        total = total - loss.weights[meaning] * likely.log()
        weights = weights + loss.weights[meaning]
    return total / weights


def test_the_word_loss_is_the_cross_entropy_of_cosines_over_the_temperature() -> None:
    loss = loss_over_three_words([[True, False, False]], [True, True, True])

    value = loss(one_pixel(0.6, 0.8, 0.0), plain_head(), torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0]))

    expected = -1.2 + math.log(math.exp(1.2) + math.exp(1.6) + 1)
    assert float(value) == pytest.approx(expected, rel=1e-5)


def test_a_word_that_the_set_does_not_know_is_not_taught_against() -> None:
    loss = loss_over_three_words([[True, False, False]], [True, False, True])
    meanings, sets = torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0])

    with_unknown_word = loss(one_pixel(0.6, 0.8, 0.0), plain_head(), meanings, sets)

    assert float(with_unknown_word) == pytest.approx(-1.2 + math.log(math.exp(1.2) + 1), rel=1e-5)


def test_a_coarse_class_is_satisfied_by_any_of_its_words() -> None:
    loss = loss_over_three_words([[True, True, False]], [True, True, True])
    meanings, sets = torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0])

    assert float(loss(one_pixel(1, 0, 0), plain_head(), meanings, sets)) == pytest.approx(
        float(loss(one_pixel(0, 1, 0), plain_head(), meanings, sets))
    )
    assert float(loss(one_pixel(1, 0, 0), plain_head(), meanings, sets)) < float(
        loss(one_pixel(0, 0, 1), plain_head(), meanings, sets)
    )


def test_pictures_and_pixels_without_labels_teach_nothing() -> None:
    loss = loss_over_three_words([[True, False, False]], [True, True, True])
    pixel = one_pixel(0, 0, 1)

    assert float(loss(pixel, plain_head(), torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([-1]))) == 0
    nothing = torch.full((1, 2, 2), -1, dtype=torch.int16)
    assert float(loss(pixel, plain_head(), nothing, torch.tensor([0]))) == 0
    none = torch.zeros(0, dtype=torch.int64)
    assert [float(part) for part in loss.with_overlap(torch.zeros(0, 3), none, none)] == [0, 0]


def test_beside_the_word_loss_stands_how_little_answers_and_labels_overlap() -> None:
    torch.manual_seed(0)
    members = torch.tensor([[True, False, False], [False, True, True], [True, True, False]])
    known = torch.tensor([[True, True, True], [True, True, True], [True, True, False]])
    loss = WordLoss(torch.eye(3), members, known, torch.tensor([1.0, 3.0, 2.0]), temperature=0.5)
    owners = torch.tensor([0, 1])  # the first two meanings are the first set's, the third is the second's
    meanings = torch.tensor([[[0, 1], [1, -1]], [[2, 2], [-1, -1]]], dtype=torch.int16)
    joined = torch.randn(2, 3, 2, 2)

    taught = meanings >= 0
    embeddings = F.normalize(joined, dim=1).permute(0, 2, 3, 1)[taught]
    sets = owners[:, None, None].expand_as(meanings)[taught]
    entropy, overlap = loss.with_overlap(embeddings, meanings[taught].long(), sets)

    scores = (F.normalize(joined, dim=1) / 0.5).exp()
    first = scores[0, :, [0, 0, 1], [0, 1, 0]] / scores[0, :, [0, 0, 1], [0, 1, 0]].sum(dim=0)
    second = scores[1, :2, 0] / scores[1, :2, 0].sum(dim=0)
    road, wall, any_of_two = first[0], first[1] + first[2], second.sum(dim=0)
    expected = torch.stack(
        [
            road[0] / (road.sum() + 1 - road[0]),
            wall[1:].sum() / (wall.sum() + 2 - wall[1:].sum()),
            any_of_two.sum() / 2,
        ]
    )
    assert float(entropy) == pytest.approx(float(loss(joined, plain_head(), meanings, owners)), rel=1e-5)
    assert float(overlap) == pytest.approx(1 - float(expected.mean()), rel=1e-5)


def test_the_word_loss_without_embeddings_is_the_one_with_them() -> None:
    torch.manual_seed(0)
    members = torch.rand(5, 12) < 0.3
    members[range(5), range(5)] = True
    known = torch.rand(5, 12) < 0.7
    known[:, :5] = True
    vectors = F.normalize(torch.randn(12, 512), dim=1)
    loss = WordLoss(vectors, members & known.all(dim=0), known, torch.rand(5) + 0.1, temperature=0.07)
    head = nn.Conv2d(96, 512, 1)
    joined = torch.randn(3, 96, 4, 6, requires_grad=True)
    meanings, sets = torch.randint(-1, 5, (3, 8, 12), dtype=torch.int16), torch.tensor([1, -1, 0])
    given = [joined, head.weight, head.bias]

    quick = loss(joined, head, meanings, sets)
    slow = by_definition(loss, head(joined), meanings[:, 1::2, 1::2], sets)

    assert quick.item() == pytest.approx(slow.item(), rel=1e-5)
    for one, other in zip(torch.autograd.grad(quick, given), torch.autograd.grad(slow, given), strict=True):  # type: ignore[arg-type]
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-6)


def test_cells_that_find_themselves_again_cost_little() -> None:
    points = torch.eye(6).view(2, 3, 6)
    cells = torch.tensor([[0, 10, 20], [0, 10, 20]])

    right, found = two_view_loss(points, points, cells, columns=32, temperature=0.07, margin=1)
    wrong, lost = two_view_loss(points, points.flip(0), cells, columns=32, temperature=0.07, margin=1)

    assert float(right) < 0.01
    assert float(wrong) > 10
    assert (float(found), float(lost)) == (1.0, 0.0)


def test_neighbouring_cells_are_not_held_against_each_other() -> None:
    same = torch.ones(1, 2, 4) / 2

    neighbours, _ = two_view_loss(same, same, torch.tensor([[0, 1]]), columns=32, temperature=0.07, margin=2)
    unknown_places, _ = two_view_loss(same, same, torch.tensor([[0, 9]]), columns=32, temperature=0.07, margin=2)

    assert float(neighbours) == pytest.approx(0, abs=1e-6)
    assert float(unknown_places) == pytest.approx(math.log(2), rel=1e-5)


def test_a_network_as_alike_as_its_teacher_pays_nothing() -> None:
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
