"""Losses on labelled pixels: their embeddings come near the text vectors of their labels and away from others.

The cross-entropy of LSeg (Li et al. 2022, "Language-driven Semantic Segmentation") over cosine / temperature, where a
class of a data set may stand for several text labels and only labels that compete with the class take part
(`training.data.lexicon.Lexicon.competing`); and a soft IoU.
"""

from collections.abc import Mapping

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.lexicon import Lexicon
from training.data.sources import Source, class_shares

TEMPERATURE = 0.07

CLASS_WEIGHT_POWER = -0.4
"""A pixel's weight is its class's share of all labelled pixels to this power: a pole weighs four times as much as a
road."""

_EXCLUDED = -1e4
"""Score of labels that take no part in a softmax."""


class LabelLoss(nn.Module):
    """Cross-entropy over the text labels that compete with a pixel's class.

    Parameters
    ----------
    vectors : float of shape (n_labels, channels)
        Centred CLIP vectors of the lexicon's labels, in the space of the embeddings.
    allowed : bool of shape (n_classes, n_labels)
        Which labels each class may stand for.
    competing : bool of shape (n_classes, n_labels)
        Which labels take part in the softmax of a pixel of each class.
    weights : float of shape (n_classes,)
        Weight of a pixel of each class.
    temperature : float
        What cosines are divided by.
    """

    vectors: Tensor
    allowed: Tensor
    competing: Tensor
    weights: Tensor

    def __init__(
        self, vectors: Tensor, allowed: Tensor, competing: Tensor, weights: Tensor, temperature: float = TEMPERATURE
    ) -> None:
        super().__init__()
        self.register_buffer("vectors", vectors)
        self.register_buffer("allowed", allowed)
        self.register_buffer("competing", competing)
        self.register_buffer("weights", weights)
        self.temperature = temperature

    def forward(self, joined: Tensor, head: nn.Conv2d, classes: Tensor, sets: Tensor) -> Tensor:
        """Compare the embeddings of the semantic head with labels, without making the embeddings.

        Parameters
        ----------
        joined : float of shape (n, inputs, h, w)
            Input of the head.
        head : Conv2d
            1x1 convolution from `inputs` to the channels of ``vectors``.
        classes : int of shape (n, k h, k w)
            -1 where there is no label. Of every k x k labels the middle one counts.
        sets : int64 of shape (n,)
            -1 for images without labels.

        Returns
        -------
        float, a scalar
            Weighted mean of -log p(the allowed labels); 0 when no pixel has a label.
        """
        step = classes.shape[-1] // joined.shape[-1]
        classes = classes[:, step // 2 :: step, step // 2 :: step]
        labelled = (classes >= 0) & (sets >= 0)[:, None, None]
        if not bool(labelled.any()):
            return joined.sum() * 0
        target = classes[labelled].long()
        scores = self._scores(joined.permute(0, 2, 3, 1)[labelled], head)
        allowed = torch.logsumexp(scores + _mask(self.allowed[target]), dim=1)
        competing = torch.logsumexp(scores + _mask(self.competing[target]), dim=1)
        return self._weighted_mean(competing - allowed, target)

    def with_soft_iou(self, embeddings: Tensor, target: Tensor, owner: Tensor) -> tuple[Tensor, Tensor]:
        """Give the same cross-entropy and, beside it, 1 less the mean soft IoU.

        Parameters
        ----------
        embeddings : float of shape (pixels, channels)
            Unit length, or an interpolation of such.
        target, owner : int64 of shape (pixels,)
            Each pixel's class, and the data set of its image.

        Returns
        -------
        entropy : float, a scalar
            As `forward` gives it.
        loss : float, a scalar in 0..1
            1 less the mean of sum(p t) / sum(p + t - p t) over the classes that the batch shows, where p is a pixel's
            probability of the class, summed over its labels, and t is 1 for pixels of the class, else 0. Only pixels
            of the class's own data set count.
        """
        if not len(target):
            return embeddings.sum() * 0, embeddings.sum() * 0
        scores = embeddings @ (self.vectors.T / self.temperature)
        of_label = (scores + _mask(self.competing[target])).softmax(dim=1)
        of_class = of_label @ self.allowed.to(scores).T
        entropy = -of_class.gather(1, target[:, None])[:, 0].clamp_min(1e-20).log()
        truth = F.one_hot(target, of_class.shape[1]).to(of_class)
        pixels = truth.sum(dim=0)
        intersection = (of_class * truth).sum(dim=0)
        owners = F.one_hot(owner).to(of_class)
        predicted = owners.T @ of_class  # of each class, on the pixels of each set
        belongs = (owners.T @ truth) > 0
        union = (predicted * belongs).sum(dim=0) + pixels - intersection
        shown = pixels > 0
        return self._weighted_mean(entropy, target), 1 - (intersection[shown] / union[shown]).mean()

    def _weighted_mean(self, entropy: Tensor, target: Tensor) -> Tensor:
        weight = self.weights[target]
        return (weight * entropy).sum() / weight.sum().clamp_min(1e-9)

    def _scores(self, y: Tensor, head: nn.Conv2d) -> Tensor:
        """Score inputs of the head, float (pixels, inputs), against all labels: float (pixels, n_labels).

        The embedding is e = [W b] [y; 1], so its length is the root of [y; 1]' G [y; 1] with G = [W b]' [W b], and
        its products with the labels need only ``vectors`` [W b]: 97 channels instead of 512.
        """
        y = torch.cat([y, torch.ones_like(y[:, :1])], dim=1)
        assert head.bias is not None
        matrix = torch.cat([head.weight.flatten(1), head.bias[:, None]], dim=1)
        squares = (y * (y @ (matrix.T @ matrix))).sum(dim=1, keepdim=True)
        return (y / (squares.clamp_min(1e-12).sqrt() * self.temperature)) @ (self.vectors @ matrix).T


def label_loss_of(
    sources: Mapping[str, Source], lexicon: Lexicon, vectors: Tensor, *, weight_power: float = CLASS_WEIGHT_POWER
) -> LabelLoss:
    """Build the loss for what is to be trained on.

    Parameters
    ----------
    sources : mapping of str to Source
    lexicon : Lexicon
    vectors : float32 of shape (n_labels, channels)
        Of the lexicon's labels, in the space of the embeddings.
    weight_power : float
        A pixel's weight is its class's share of all labelled pixels to this power, over the mean of all classes.
    """
    weights = (class_shares(sources, lexicon) + 1e-4) ** weight_power
    return LabelLoss(
        vectors,
        torch.from_numpy(lexicon.allowed()),
        torch.from_numpy(lexicon.competing()),
        torch.from_numpy((weights / weights.mean()).astype(np.float32)),
    )


def _mask(taking_part: Tensor) -> Tensor:
    """Turn bool into what is added to scores: 0 where True."""
    return taking_part.logical_not() * _EXCLUDED
