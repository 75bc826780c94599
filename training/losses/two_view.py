"""What training asks of two views of one scene; `training.losses.label_loss` is what it asks of labelled pixels.

- `two_view_loss`: a cell finds itself again in another view, among all other cells of the batch.
- `similarity_loss`: cells are as alike as they were to a frozen teacher.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

_NEVER = -1e4


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
    images, points = cells.shape
    if images == 0:
        return here.sum() * 0, here.new_zeros(())
    scores = here.flatten(0, 1) @ there.flatten(0, 1).T / temperature
    image = torch.arange(images, device=cells.device).repeat_interleave(points)
    row, column = (cells // columns).flatten(), (cells % columns).flatten()
    near = (
        (image[:, None] == image)
        & ((row[:, None] - row).abs() <= margin)
        & ((column[:, None] - column).abs() <= margin)
    )
    near.fill_diagonal_(False)
    scores = scores.masked_fill(near, _NEVER)
    right = torch.arange(len(scores), device=scores.device)
    loss = (F.cross_entropy(scores, right) + F.cross_entropy(scores.T, right)) / 2
    return loss, (scores.argmax(dim=1) == right).float().mean()


def similarity_loss(here: Tensor, there: Tensor, here_before: Tensor, there_before: Tensor) -> Tensor:
    """Mean squared difference between two networks' cosines of all cells of one view with all of the other.

    All four are of shape (n, points, channels), unit length; the last two are the teacher's.
    """
    if len(here) == 0:
        return here.sum() * 0
    now = here.flatten(0, 1) @ there.flatten(0, 1).T
    before = here_before.flatten(0, 1) @ there_before.flatten(0, 1).T
    return F.mse_loss(now, before)
