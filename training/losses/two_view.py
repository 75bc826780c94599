"""Losses over two views of one scene.

- `two_view_loss`: a cell has to find the corresponding cell of the other view among all cells of the batch.
- `similarity_loss`: cosines between cells stay what they are for a frozen teacher.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

_EXCLUDED = -1e4
"""Score of pairs that take no part in a softmax."""


def matched_cells(fields: Tensor, cells: Tensor, positions: Tensor) -> tuple[Tensor, Tensor]:
    """Read both views' fields at corresponding points.

    Parameters
    ----------
    fields : float of shape (2 n, channels, h, w)
        First views, then second views.
    cells : int64 of shape (n, points)
        Cells of the first views, numbered row by row.
    positions : float of shape (n, points, 2)
        The same points in the second views: x and y, -1..1.

    Returns
    -------
    two float of shape (n, points, channels)
        Of the first views as they are, of the second views interpolated bilinearly.
    """
    first, second = fields.chunk(2)
    channels = fields.shape[1]
    here = first.flatten(2).gather(2, cells[:, None].expand(-1, channels, -1))
    there = F.grid_sample(second, positions[:, None], align_corners=False)[:, :, 0]
    return here.transpose(1, 2), there.transpose(1, 2)


def two_view_loss(
    here: Tensor, there: Tensor, cells: Tensor, columns: int, temperature: float, margin: int
) -> tuple[Tensor, Tensor]:
    """Contrast corresponding cells with all others, in both directions (InfoNCE).

    Parameters
    ----------
    here, there : float of shape (n, points, channels)
        Unit length; row i of both shows the same point.
    cells : int64 of shape (n, points)
        Where the points are in the first views, whose fields have `columns` columns.
    columns : int
    temperature : float
        What cosines are divided by.
    margin : int
        Points of one image that are at most this many cells apart are not contrasted with each other.

    Returns
    -------
    loss : float, a scalar
    accuracy : float, a scalar
        Share of cells whose nearest cell of the other view is the corresponding one, 0..1.
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
    scores = scores.masked_fill(near, _EXCLUDED)
    target = torch.arange(len(scores), device=scores.device)
    loss = (F.cross_entropy(scores, target) + F.cross_entropy(scores.T, target)) / 2
    return loss, (scores.argmax(dim=1) == target).float().mean()


def similarity_loss(here: Tensor, there: Tensor, teacher_here: Tensor, teacher_there: Tensor) -> Tensor:
    """Mean squared difference between a network's and its teacher's cosines of all cells of either view.

    Parameters
    ----------
    here, there : float of shape (n, points, channels)
        Unit length.
    teacher_here, teacher_there : float of shape (n, points, channels of the teacher)
        The same points, unit length.

    Returns
    -------
    float, a scalar
    """
    if len(here) == 0:
        return here.sum() * 0
    cosines = here.flatten(0, 1) @ there.flatten(0, 1).T
    wanted = teacher_here.flatten(0, 1) @ teacher_there.flatten(0, 1).T
    return F.mse_loss(cosines, wanted)
