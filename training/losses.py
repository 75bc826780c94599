"""The three things that training asks of the network.

- `word_loss`: a pixel is near the words that its label allows, and far from the others that its data set knows
  (LSeg's cross-entropy over cosine / temperature; a coarse class means "one of these words").
- `two_view_loss`: a cell finds itself again in another view, among all other cells of the batch.
- `likeness_loss`: cells are as alike as they were to a frozen teacher.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

_NEVER = -1e4


class WordLoss(torch.nn.Module):
    """Cross-entropy over the words that a picture's data set knows.

    Parameters
    ----------
    vectors : float of shape (n_words, channels)
        Centred CLIP vectors, unit length.
    members : bool of shape (n_meanings, n_words)
        Which words each meaning allows.
    known : bool of shape (n_sets, n_words)
        Which words each set knows.
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
        self.register_buffer("members", members.float())
        self.register_buffer("known", known)
        self.register_buffer("weights", weights)
        self.temperature = temperature

    def cosines(self, joined: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        """Give the cosines of the words head's embeddings with all words, without making the embeddings.

        The embedding is e = [W b] [y; 1], so its length is the root of [y; 1]' G [y; 1] with G = [W b]' [W b], and
        its products with the words need only ``vectors`` [W b]: 97 channels instead of 512.

        Parameters
        ----------
        joined : float of shape (n, inputs, h, w)
            What the words head reads: y.
        weight, bias : float of shapes (channels, inputs, 1, 1) and (channels,)
            The words head's: W and b.

        Returns
        -------
        float of shape (n, n_words, h, w)
        """
        whole = torch.cat([weight.flatten(1), bias[:, None]], dim=1)
        y = torch.cat([joined, torch.ones_like(joined[:, :1])], dim=1)
        squares = (y * torch.einsum("nchw,dc->ndhw", y, whole.T @ whole)).sum(dim=1, keepdim=True)
        return torch.einsum("nchw,kc->nkhw", y, self.vectors @ whole) / squares.clamp_min(1e-12).sqrt()

    def forward(self, cosines: Tensor, meanings: Tensor, sets: Tensor) -> Tensor:
        """Compare cosines with labels.

        Parameters
        ----------
        cosines : float of shape (n, n_words, h, w)
            At stride 8 or 4.
        meanings : int of shape (n, 2 h, 2 w) or (n, h, w)
            At stride 4; -1 where nothing is known.
        sets : int64 of shape (n,)
            -1 for pictures without labels.

        Returns
        -------
        float, a scalar
            Mean of -log p(one of the allowed words), weighted; 0 when no pixel has a label.
        """
        labelled = sets >= 0
        if not bool(labelled.any()):
            return cosines.sum() * 0
        cosines, meanings, sets = cosines[labelled], meanings[labelled].long(), sets[labelled]
        scores = (cosines / self.temperature).masked_fill(~self.known[sets][:, :, None, None], _NEVER)
        if scores.shape[-2:] != meanings.shape[-2:]:
            scores = F.interpolate(scores, size=meanings.shape[-2:], mode="bilinear", align_corners=False)
        allowed = torch.einsum("nkhw,mk->nmhw", scores.softmax(dim=1), self.members)
        taught = meanings >= 0
        target = meanings.clamp_min(0)
        likely = allowed.gather(1, target[:, None])[:, 0]
        weight = self.weights[target] * taught
        return -(weight * torch.log(likely + 1e-9)).sum() / weight.sum().clamp_min(1e-9)


def matched_cells(fields: Tensor, cells: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Read both views' embeddings of the same points.

    Parameters
    ----------
    fields : float of shape (2 n, channels, h, w)
        First views, then second views.
    cells : int64 of shape (n, points)
        Cells of the first views.
    positions : float of shape (n, points, 2)
        Where the second views show them, -1..1.

    Returns
    -------
    two float of shape (n, points, channels)
        Unit length.
    """
    first, second = fields.chunk(2)
    channels = fields.shape[1]
    here = first.flatten(2).gather(2, cells[:, None].expand(-1, channels, -1))
    there = F.grid_sample(second, positions[:, None], align_corners=False)[:, :, 0]
    return here.transpose(1, 2), F.normalize(there.transpose(1, 2), dim=2)


def two_view_loss(
    here: Tensor, there: Tensor, cells: Tensor, columns: int, temperature: float, margin: int
) -> tuple[Tensor, Tensor]:
    """Contrast matching cells with all others, both ways (InfoNCE).

    Parameters
    ----------
    here, there : float of shape (n, points, channels)
        Unit length; row by row the same points.
    cells : int64 of shape (n, points)
        Where the points are in the first views, whose fields have `columns` columns.
    margin
        Points of one picture that are at most this many cells apart are not held against each other.

    Returns
    -------
    loss : float, a scalar
    found : float, a scalar
        Share of cells whose nearest cell of the other view is the right one.
    """
    pictures, points = cells.shape
    if pictures == 0:
        return here.sum() * 0, here.new_zeros(())
    scores = here.flatten(0, 1) @ there.flatten(0, 1).T / temperature
    picture = torch.arange(pictures, device=cells.device).repeat_interleave(points)
    row, column = (cells // columns).flatten(), (cells % columns).flatten()
    near = (
        (picture[:, None] == picture)
        & ((row[:, None] - row).abs() <= margin)
        & ((column[:, None] - column).abs() <= margin)
    )
    near.fill_diagonal_(False)
    scores = scores.masked_fill(near, _NEVER)
    right = torch.arange(len(scores), device=scores.device)
    loss = (F.cross_entropy(scores, right) + F.cross_entropy(scores.T, right)) / 2
    return loss, (scores.argmax(dim=1) == right).float().mean()


def likeness_loss(here: Tensor, there: Tensor, here_before: Tensor, there_before: Tensor) -> Tensor:
    """Mean squared difference between two networks' cosines of all cells of one view with all of the other.

    All four are of shape (n, points, channels), unit length; the last two are the teacher's.
    """
    if len(here) == 0:
        return here.sum() * 0
    now = here.flatten(0, 1) @ there.flatten(0, 1).T
    before = here_before.flatten(0, 1) @ there_before.flatten(0, 1).T
    return F.mse_loss(now, before)
