"""Pixels drawn at random, and what is said of them: embeddings between cells, and another network's opinions."""

from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor


class Points(NamedTuple):
    """Pixels of a batch's views: int64 of shape (m,) each."""

    view: Tensor
    row: Tensor
    column: Tensor


def draw(views: int, size: tuple[int, int], each: int, device: torch.device) -> Points:
    """Draw `each` pixels of every view of `size` (height, width)."""
    height, width = size
    view = torch.arange(views, device=device).repeat_interleave(each)
    row, column = (torch.randint(side, (views * each,), device=device) for side in (height, width))
    return Points(view, row, column)


def interpolated(embeddings: Tensor, points: Points, size: tuple[int, int]) -> Tensor:
    """Read embeddings where pixels are, between cells as a segmentation does: bilinear, cells as pixels of `size`.

    Parameters
    ----------
    embeddings : float of shape (views, h, w, channels)

    Returns
    -------
    float of shape (m, channels)
    """
    _, rows, columns, _ = embeddings.shape
    above, below, down = _neighbours(points.row, size[0], rows)
    left, right, across = _neighbours(points.column, size[1], columns)
    cells = torch.stack([(points.view * rows + y) * columns + x for y in (above, below) for x in (left, right)], dim=1)
    shares = torch.stack([y * x for y in (1 - down, down) for x in (1 - across, across)], dim=1)
    return F.embedding_bag(cells, embeddings.flatten(0, 2), mode="sum", per_sample_weights=shares)


def _neighbours(pixel: Tensor, size: int, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """Name the two cells whose centres a pixel's centre lies between, along one side, and the second one's share."""
    at = ((pixel + 0.5) * (cells / size) - 0.5).clamp(0, cells - 1)
    first = at.floor().long().clamp(max=cells - 2)
    return first, first + 1, at - first


def read_in_source(fields: Tensor, to_source: Tensor, points: Points, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Read fields of the pictures that views of `size` were cut from where the views' pixels lie in them.

    Parameters
    ----------
    fields : float of shape (views, channels, h, w)
        Each over its whole picture.
    to_source : float of shape (views, 3, 3)
        Homographies from a view to its picture, both 0..1: `training.data.batches.viewpoint.View.to_source`.

    Returns
    -------
    float of shape (m, channels), bool of shape (m,)
        What the fields say there, and whether the pixels lie inside the pictures.
    """
    height, width = size
    there = torch.stack([(points.column + 0.5) / width, (points.row + 0.5) / height], dim=1)
    there = F.pad(there, (0, 1), value=1.0)
    source = (to_source[points.view] @ there[:, :, None])[:, :, 0]
    place = source[:, :2] / source[:, 2:]
    grid = (place * 2 - 1).view(len(fields), -1, 1, 2)
    read = F.grid_sample(fields, grid, padding_mode="border", align_corners=False)[..., 0]
    return read.permute(0, 2, 1).flatten(0, 1), ((place >= 0) & (place <= 1)).all(dim=1)
