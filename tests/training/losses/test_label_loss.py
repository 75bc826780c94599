import math

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.losses.label_loss import LabelLoss


def one_pixel(x: float, y: float, z: float) -> torch.Tensor:
    return torch.tensor([x, y, z], dtype=torch.float32).view(1, 3, 1, 1)


def loss_over_three_labels(allowed: list[list[bool]], competing: list[bool]) -> LabelLoss:
    return LabelLoss(
        torch.eye(3), torch.tensor(allowed), torch.tensor([competing] * len(allowed)), torch.ones(len(allowed)), 0.5
    )


def plain_head() -> nn.Conv2d:
    """A semantic head that is the identity."""
    head = nn.Conv2d(3, 3, 1)
    head.load_state_dict({"weight": torch.eye(3)[:, :, None, None], "bias": torch.zeros(3)})
    return head.requires_grad_(False)


def by_definition(loss: LabelLoss, embeddings: Tensor, classes: Tensor, sets: Tensor) -> Tensor:
    """The label loss pixel by pixel, from embeddings (n, channels, h, w) and classes (n, h, w)."""
    total, weights = torch.zeros(()), torch.zeros(())
    for number, row, column in (classes >= 0).nonzero().tolist():
        each, data_set = int(classes[number, row, column]), int(sets[number])
        if data_set < 0:
            continue
        scores = (loss.vectors @ F.normalize(embeddings[number, :, row, column], dim=0) / loss.temperature).exp()
        likely = scores[loss.allowed[each]].sum() / scores[loss.competing[each]].sum()
        total = total - loss.weights[each] * likely.log()
        weights = weights + loss.weights[each]
    return total / weights


def test_the_label_loss_is_the_cross_entropy_of_cosines_over_the_temperature() -> None:
    loss = loss_over_three_labels([[True, False, False]], [True, True, True])

    value = loss(one_pixel(0.6, 0.8, 0.0), plain_head(), torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0]))

    expected = -1.2 + math.log(math.exp(1.2) + math.exp(1.6) + 1)
    assert float(value) == pytest.approx(expected, rel=1e-5)


def test_a_label_that_does_not_compete_with_the_class_takes_no_part() -> None:
    loss = loss_over_three_labels([[True, False, False]], [True, False, True])
    classes, sets = torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0])

    value = loss(one_pixel(0.6, 0.8, 0.0), plain_head(), classes, sets)

    assert float(value) == pytest.approx(-1.2 + math.log(math.exp(1.2) + 1), rel=1e-5)


def test_a_class_of_several_labels_is_satisfied_by_any_of_them() -> None:
    loss = loss_over_three_labels([[True, True, False]], [True, True, True])
    classes, sets = torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([0])

    assert float(loss(one_pixel(1, 0, 0), plain_head(), classes, sets)) == pytest.approx(
        float(loss(one_pixel(0, 1, 0), plain_head(), classes, sets))
    )
    assert float(loss(one_pixel(1, 0, 0), plain_head(), classes, sets)) < float(
        loss(one_pixel(0, 0, 1), plain_head(), classes, sets)
    )


def test_images_and_pixels_without_labels_add_nothing() -> None:
    loss = loss_over_three_labels([[True, False, False]], [True, True, True])
    pixel = one_pixel(0, 0, 1)

    assert float(loss(pixel, plain_head(), torch.zeros(1, 2, 2, dtype=torch.int16), torch.tensor([-1]))) == 0
    nothing = torch.full((1, 2, 2), -1, dtype=torch.int16)
    assert float(loss(pixel, plain_head(), nothing, torch.tensor([0]))) == 0
    none = torch.zeros(0, dtype=torch.int64)
    assert [float(part) for part in loss.with_soft_iou(torch.zeros(0, 3), none, none)] == [0, 0]


def test_beside_the_cross_entropy_stands_one_less_the_mean_soft_iou() -> None:
    torch.manual_seed(0)
    allowed = torch.tensor([[True, False, False], [False, True, True], [True, True, False]])
    competing = torch.tensor([[True, True, True], [True, True, True], [True, True, False]])
    loss = LabelLoss(torch.eye(3), allowed, competing, torch.tensor([1.0, 3.0, 2.0]), temperature=0.5)
    owners = torch.tensor([0, 1])  # of each class's set
    classes = torch.tensor([[[0, 1], [1, -1]], [[2, 2], [-1, -1]]], dtype=torch.int16)
    joined = torch.randn(2, 3, 2, 2)

    labelled = classes >= 0
    embeddings = F.normalize(joined, dim=1).permute(0, 2, 3, 1)[labelled]
    sets = owners[:, None, None].expand_as(classes)[labelled]
    entropy, soft_iou = loss.with_soft_iou(embeddings, classes[labelled].long(), sets)

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
    assert float(entropy) == pytest.approx(float(loss(joined, plain_head(), classes, owners)), rel=1e-5)
    assert float(soft_iou) == pytest.approx(1 - float(expected.mean()), rel=1e-5)


def test_the_label_loss_computed_without_embeddings_is_that_with_them() -> None:
    torch.manual_seed(0)
    allowed = torch.rand(5, 12) < 0.3
    allowed[range(5), range(5)] = True
    competing = torch.rand(5, 12) < 0.7
    competing[:, :5] = True
    vectors = F.normalize(torch.randn(12, 512), dim=1)
    loss = LabelLoss(vectors, allowed & competing.all(dim=0), competing, torch.rand(5) + 0.1, temperature=0.07)
    head = nn.Conv2d(96, 512, 1)
    joined = torch.randn(3, 96, 4, 6, requires_grad=True)
    classes, sets = torch.randint(-1, 5, (3, 8, 12), dtype=torch.int16), torch.tensor([1, -1, 0])
    given = [joined, head.weight, head.bias]

    quick = loss(joined, head, classes, sets)
    slow = by_definition(loss, head(joined), classes[:, 1::2, 1::2], sets)

    assert quick.item() == pytest.approx(slow.item(), rel=1e-5)
    for one, other in zip(torch.autograd.grad(quick, given), torch.autograd.grad(slow, given), strict=True):  # type: ignore[arg-type]
        assert torch.allclose(one, other, rtol=1e-3, atol=1e-6)
