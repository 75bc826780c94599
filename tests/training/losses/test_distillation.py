import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from training.losses.distillation import DistillationLoss

ALLOWED = torch.tensor([[True, False, False], [False, True, True]])


def test_the_loss_is_the_divergence_over_the_teachers_labels() -> None:
    loss = DistillationLoss(torch.eye(3), ALLOWED, temperature=0.5)
    embeddings = F.normalize(torch.tensor([[1.0, 2.0, 0.5], [0.1, 0.2, 0.9]]), dim=1)
    soft_labels = torch.tensor([[0.2, 0.5, 0.3], [0.6, 0.4, 0.0]])

    value = loss(embeddings, soft_labels, torch.tensor([-1, 0]))

    student = (embeddings / 0.5).softmax(dim=1)
    expected = [(p[p > 0] * (p[p > 0] / q[p > 0]).log()).sum() for p, q in zip(soft_labels, student, strict=True)]
    assert float(value) == pytest.approx(float(sum(expected) / 2), rel=1e-5)
    exactly = torch.tensor([1.0, 0.0, 0.0]).div(0.5).softmax(dim=0)[None]
    assert float(loss(torch.eye(3)[:1], exactly, torch.tensor([-1]))) == pytest.approx(0, abs=1e-6)


def test_soft_labels_that_the_class_contradicts_do_not_count_and_neither_do_missing_ones() -> None:
    loss = DistillationLoss(torch.eye(3), ALLOWED, temperature=0.5)
    embeddings = torch.eye(3)[[2]].requires_grad_(True)
    certain_of_the_first, nothing = torch.tensor([[0.95, 0.05, 0.0]]), torch.zeros(1, 3)

    assert float(loss(embeddings, certain_of_the_first, torch.tensor([1])).detach()) == 0
    assert float(loss(embeddings, certain_of_the_first, torch.tensor([0])).detach()) > 1
    none = loss(embeddings, nothing, torch.tensor([0]))
    assert float(none.detach()) == 0
    none.backward()
    assert embeddings.grad is not None
