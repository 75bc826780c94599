"""What another network says of pixels, as something to learn from: Hinton, Vinyals and Dean 2015, "Distilling the
Knowledge in a Neural Network".

The trunk as it was downloaded has seen fences, poles and people of more towns than there are labelled pictures here.
"""

import torch
from torch import Tensor, nn

from training.data.lexicon import STREET_WORDS, Lexicon
from training.losses.label_loss import WORD_TEMPERATURE

LEAST_AGREEMENT = 0.1
"""How likely the teacher has to find what a pixel's label says, or its opinion does not count there."""


class OpinionLoss(nn.Module):
    """Relative entropy between a teacher's probabilities of some words and ours of the same words.

    Parameters
    ----------
    vectors : float of shape (n_spoken, channels)
        Centred CLIP vectors of the teacher's words.
    agrees : bool of shape (n_meanings, n_spoken)
        Which of them each label allows.
    temperature
        What cosines are divided by.
    """

    vectors: Tensor
    agrees: Tensor

    def __init__(self, vectors: Tensor, agrees: Tensor, temperature: float = WORD_TEMPERATURE) -> None:
        super().__init__()
        self.register_buffer("vectors", vectors)
        self.register_buffer("agrees", agrees)
        self.temperature = temperature

    def forward(self, embeddings: Tensor, opinions: Tensor, target: Tensor) -> Tensor:
        """Compare what both say.

        Parameters
        ----------
        embeddings : float of shape (pixels, channels)
            Unit length, or an interpolation of such.
        opinions : float of shape (pixels, n_spoken)
            The teacher's probabilities; all 0 where it has none.
        target : int64 of shape (pixels,)
            Meanings, -1 for pixels without a label.

        Returns
        -------
        float, a scalar
            Mean over the pixels that have an opinion which their label, if there is one, does not contradict; 0 without
            such pixels.
        """
        agreement = (opinions * self.agrees[target]).sum(dim=1)
        counts = (opinions.sum(dim=1) > 0.5) & ((target < 0) | (agreement >= LEAST_AGREEMENT))
        if not bool(counts.any()):
            return embeddings.sum() * 0
        attributes = opinions[counts] / opinions[counts].sum(dim=1, keepdim=True)
        ours = (embeddings[counts] @ self.vectors.T / self.temperature).log_softmax(dim=1)
        return (torch.xlogy(attributes, attributes) - attributes * ours).sum(dim=1).mean()


def opinion_loss_of(lexicon: Lexicon, vectors: Tensor) -> OpinionLoss:
    """Build the loss for the trunk's words, given the vectors of the lexicon's."""
    spoken = [lexicon.words.index(word) for word in STREET_WORDS]
    return OpinionLoss(vectors[spoken], torch.from_numpy(lexicon.members())[:, spoken])
