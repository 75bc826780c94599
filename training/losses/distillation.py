"""Knowledge distillation from the pretrained trunk (Hinton, Vinyals and Dean 2015).

The trunk was trained on more towns than there are labelled images here, so its soft labels are learned from beside the
label maps.
"""

import torch
from torch import Tensor, nn

from training.data.lexicon import CITYSCAPES_LABELS, Lexicon
from training.losses.label_loss import TEMPERATURE

LEAST_AGREEMENT = 0.1
"""Where the teacher gives the labels of a pixel's class less probability than this, its soft labels are ignored."""


class DistillationLoss(nn.Module):
    """Kullback-Leibler divergence between a teacher's probabilities of some labels and the network's of the same.

    Parameters
    ----------
    vectors : float of shape (n_teacher, channels)
        Centred CLIP vectors of the teacher's labels, in the space of the embeddings.
    allowed : bool of shape (n_classes, n_teacher)
        Which of them each class may stand for.
    temperature : float
        What cosines are divided by.
    """

    vectors: Tensor
    allowed: Tensor

    def __init__(self, vectors: Tensor, allowed: Tensor, temperature: float = TEMPERATURE) -> None:
        super().__init__()
        self.register_buffer("vectors", vectors)
        self.register_buffer("allowed", allowed)
        self.temperature = temperature

    def forward(self, embeddings: Tensor, soft_labels: Tensor, target: Tensor) -> Tensor:
        """Compare the network with the teacher.

        Parameters
        ----------
        embeddings : float of shape (pixels, channels)
            Unit length, or an interpolation of such.
        soft_labels : float of shape (pixels, n_teacher)
            The teacher's probabilities; all 0 where it has none.
        target : int64 of shape (pixels,)
            Classes, -1 for pixels without a label.

        Returns
        -------
        float, a scalar
            Mean over the pixels that have soft labels, without those whose class the teacher contradicts; 0 if there
            are none.
        """
        agreement = (soft_labels * self.allowed[target]).sum(dim=1)
        counts = (soft_labels.sum(dim=1) > 0.5) & ((target < 0) | (agreement >= LEAST_AGREEMENT))
        if not bool(counts.any()):
            return embeddings.sum() * 0
        teacher = soft_labels[counts] / soft_labels[counts].sum(dim=1, keepdim=True)
        student = (embeddings[counts] @ self.vectors.T / self.temperature).log_softmax(dim=1)
        return (torch.xlogy(teacher, teacher) - teacher * student).sum(dim=1).mean()


def distillation_loss_of(lexicon: Lexicon, vectors: Tensor) -> DistillationLoss:
    """Build the loss for the trunk's labels from the vectors of the lexicon's, float of shape (n_labels, channels)."""
    of_teacher = [lexicon.labels.index(label) for label in CITYSCAPES_LABELS]
    return DistillationLoss(vectors[of_teacher], torch.from_numpy(lexicon.allowed())[:, of_teacher])
