"""The three things that training asks of the network.

- `word_loss`: a pixel is near the words that its label allows, and far from the others that its data set knows
  (LSeg's cross-entropy over cosine / temperature; a coarse class means "one of these words").
- `two_view_loss`: a cell finds itself again in another view, among all other cells of the batch.
- `likeness_loss`: cells are as alike as they were to a frozen teacher.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

_NEVER = -1e4


class WordLoss(nn.Module):
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
        self.register_buffer("members", members.logical_not() * _NEVER)  # added to scores
        self.register_buffer("known", known)
        self.register_buffer("weights", weights)
        self.temperature = temperature

    def forward(self, joined: Tensor, head: nn.Conv2d, meanings: Tensor, sets: Tensor) -> Tensor:
        """Compare the words head's embeddings with labels, without making the embeddings.

        The embedding is e = [W b] [y; 1], so its length is the root of [y; 1]' G [y; 1] with G = [W b]' [W b], and
        its products with the words need only ``vectors`` [W b]: 97 channels instead of 512.

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
        y = joined.permute(0, 2, 3, 1)[taught]
        y = torch.cat([y, torch.ones_like(y[:, :1])], dim=1)
        assert head.bias is not None
        whole = torch.cat([head.weight.flatten(1), head.bias[:, None]], dim=1)
        squares = (y * (y @ (whole.T @ whole))).sum(dim=1, keepdim=True)
        y = y / (squares.clamp_min(1e-12).sqrt() * self.temperature)
        scores = y @ (self.vectors @ whole).T
        known = self.known[sets].logical_not() * _NEVER
        owner = torch.arange(len(sets), device=sets.device)[:, None, None].expand_as(taught)[taught]
        likely = torch.logsumexp(scores + self.members[target], dim=1) - torch.logsumexp(scores + known[owner], dim=1)
        weight = self.weights[target]
        return -(weight * likely).sum() / weight.sum().clamp_min(1e-9)


def matched_cells(fields: Tensor, cells: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Read both views' fields at the same points.

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
        The second interpolated between cells.
    """
    first, second = fields.chunk(2)
    channels = fields.shape[1]
    here = first.flatten(2).gather(2, cells[:, None].expand(-1, channels, -1))
    there = F.grid_sample(second, positions[:, None], align_corners=False)[:, :, 0]
    return here.transpose(1, 2), there.transpose(1, 2)


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
