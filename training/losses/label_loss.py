"""What training asks of labelled pixels: to be near the words that their label allows, and far from the others.

LSeg's cross-entropy over cosine / temperature, where a coarse class means "one of these words" and only the words that
a label speaks for or against take part; and, beside it, a soft IoU.
"""

from collections.abc import Mapping

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data import batches as data
from training.data.lexicon import Lexicon

WORD_TEMPERATURE = 0.07
RARITY = -0.4
"""A pixel counts as its meaning's share of all labelled pixels to this power: a pole four times as much as road."""

_NEVER = -1e4


class WordLoss(nn.Module):
    """Cross-entropy over the words that a label speaks for or against.

    Parameters
    ----------
    vectors : float of shape (n_words, channels)
        Centred CLIP vectors, unit length.
    members : bool of shape (n_meanings, n_words)
        Which words each meaning allows.
    known : bool of shape (n_meanings, n_words)
        Which words each meaning speaks for or against.
    weights : float of shape (n_meanings,)
        How much a pixel of each meaning counts.
    temperature
        What cosines are divided by.
    """

    vectors: Tensor
    members: Tensor
    known: Tensor
    weights: Tensor

    def __init__(self, vectors: Tensor, members: Tensor, known: Tensor, weights: Tensor, temperature: float) -> None:
        super().__init__()
        self.register_buffer("vectors", vectors)
        self.register_buffer("members", members.logical_not() * _NEVER)  # added to scores
        self.register_buffer("known", known)
        self.register_buffer("weights", weights)
        self.temperature = temperature

    def forward(self, joined: Tensor, head: nn.Conv2d, meanings: Tensor, sets: Tensor) -> Tensor:
        """Compare the words head's embeddings with labels.

        Parameters
        ----------
        joined : float of shape (n, inputs, h, w)
            What the words head reads: y.
        head
            1x1 convolution from `inputs` to the channels of ``vectors``: W and b.
        meanings : int of shape (n, k h, k w)
            -1 where nothing is known; the middle one of every k x k counts.
        sets : int64 of shape (n,)
            -1 for pictures without labels.

        Returns
        -------
        float, a scalar
            Mean of -log p(one of the allowed words), weighted; 0 when no pixel has a label.
        """
        step = meanings.shape[-1] // joined.shape[-1]
        meanings = meanings[:, step // 2 :: step, step // 2 :: step]
        taught = (meanings >= 0) & (sets >= 0)[:, None, None]
        if not bool(taught.any()):
            return joined.sum() * 0
        target = meanings[taught].long()
        scores = self._scores(joined.permute(0, 2, 3, 1)[taught], head)
        allowed = torch.logsumexp(scores + self.members[target], dim=1)
        return self._weighed(torch.logsumexp(scores + self._unknown(target), dim=1) - allowed, target)

    def with_overlap(self, embeddings: Tensor, target: Tensor, owner: Tensor) -> tuple[Tensor, Tensor]:
        """Give beside that loss how little answers and labels overlap: what a mean IoU is made of, pixel by pixel soft.

        Parameters
        ----------
        embeddings : float of shape (pixels, channels)
            What the cosines are read from: unit length, or an interpolation of such.
        target, owner : int64 of shape (pixels,)
            Each pixel's meaning, and the set that its picture belongs to.

        Returns
        -------
        entropy : float, a scalar
            As `forward` gives it.
        overlap : float, a scalar in 0..1
            1 less the mean of the soft IoU (sum of p over the right pixels by the sum of p or right), over the meanings
            that the batch shows. A meaning's p is the sum over its words; pixels of other sets do not count.
        """
        if not len(target):
            return embeddings.sum() * 0, embeddings.sum() * 0
        scores = embeddings @ (self.vectors.T / self.temperature)
        likely = (scores + self._unknown(target)).softmax(dim=1) @ (self.members == 0).to(scores).T
        entropy = -likely.gather(1, target[:, None])[:, 0].clamp_min(1e-20).log()
        right = F.one_hot(target, likely.shape[1]).to(likely)
        shown = right.sum(dim=0)
        hits = (likely * right).sum(dim=0)
        owners = F.one_hot(owner).to(likely)
        answered = owners.T @ likely  # of each meaning, on the pixels of each set
        belongs = (owners.T @ right) > 0
        union = (answered * belongs).sum(dim=0) + shown - hits
        present = shown > 0
        return self._weighed(entropy, target), 1 - (hits[present] / union[present]).mean()

    def _weighed(self, entropy: Tensor, target: Tensor) -> Tensor:
        weight = self.weights[target]
        return (weight * entropy).sum() / weight.sum().clamp_min(1e-9)

    def _unknown(self, target: Tensor) -> Tensor:
        return (self.known.logical_not() * _NEVER)[target]

    def _scores(self, y: Tensor, head: nn.Conv2d) -> Tensor:
        """Score pixels, float (pixels, inputs), against all words without making their embeddings.

        The embedding is e = [W b] [y; 1], so its length is the root of [y; 1]' G [y; 1] with G = [W b]' [W b], and
        its products with the words need only ``vectors`` [W b]: 97 channels instead of 512.
        """
        y = torch.cat([y, torch.ones_like(y[:, :1])], dim=1)
        assert head.bias is not None
        whole = torch.cat([head.weight.flatten(1), head.bias[:, None]], dim=1)
        squares = (y * (y @ (whole.T @ whole))).sum(dim=1, keepdim=True)
        return (y / (squares.clamp_min(1e-12).sqrt() * self.temperature)) @ (self.vectors @ whole).T


def word_loss_of(
    found: Mapping[str, data.Source], lexicon: Lexicon, vectors: Tensor, *, rarity: float = RARITY
) -> WordLoss:
    """Build the loss for what is to be trained on.

    Parameters
    ----------
    vectors : float32 of shape (n_words, channels)
        Of the lexicon's words, in the space of the words head.
    rarity
        A pixel counts as its meaning's share of all labelled pixels, to this power.
    """
    shares = data.meaning_shares(found, lexicon)
    weights = (shares + 1e-4) ** rarity
    return WordLoss(
        vectors,
        torch.from_numpy(lexicon.members()),
        torch.from_numpy(lexicon.known()),
        torch.from_numpy((weights / weights.mean()).astype(np.float32)),
        WORD_TEMPERATURE,
    )
