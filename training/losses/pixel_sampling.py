"""Pixels drawn at random from views, and fields read at them: embeddings, and soft labels of the source images."""

from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor


class PixelIndices(NamedTuple):
    """Pixels of a batch's views: the number of the view, row and column, int64 of shape (m,) each."""

    view: Tensor
    row: Tensor
    column: Tensor


def draw_pixels(views: int, size: tuple[int, int], each: int, device: torch.device) -> PixelIndices:
    """Draw `each` pixels of every view of `size` (height, width), with replacement; m = views * each."""
    height, width = size
    view = torch.arange(views, device=device).repeat_interleave(each)
    row, column = (torch.randint(side, (views * each,), device=device) for side in (height, width))
    return PixelIndices(view, row, column)


def interpolate_at(embeddings: Tensor, pixels: PixelIndices, size: tuple[int, int]) -> Tensor:
    """Interpolate fields bilinearly at pixels, as `interpolate` with ``align_corners=False`` does for all pixels.

    Parameters
    ----------
    embeddings : float of shape (views, h, w, channels)
    pixels : PixelIndices
        Of m pixels.
    size : (int, int)
        Height and width of the views.

    Returns
    -------
    float of shape (m, channels)
    """
    _, rows, columns, _ = embeddings.shape
    above, below, down = _neighbours(pixels.row, size[0], rows)
    left, right, across = _neighbours(pixels.column, size[1], columns)
    cells = torch.stack([(pixels.view * rows + y) * columns + x for y in (above, below) for x in (left, right)], dim=1)
    weights = torch.stack([y * x for y in (1 - down, down) for x in (1 - across, across)], dim=1)
    return F.embedding_bag(cells, embeddings.flatten(0, 2), mode="sum", per_sample_weights=weights)


def _neighbours(pixel: Tensor, size: int, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """Give the two cells whose centres a pixel's centre lies between, along one side, and the weight of the second."""
    at = ((pixel + 0.5) * (cells / size) - 0.5).clamp(0, cells - 1)
    first = at.floor().long().clamp(max=cells - 2)
    return first, first + 1, at - first


def sample_source(
    fields: Tensor, to_source: Tensor, pixels: PixelIndices, size: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Read fields of the source images that views were cut from, at the views' pixels.

    Parameters
    ----------
    fields : float of shape (views, channels, h, w)
        Each over a whole source image.
    to_source : float of shape (views, 3, 3)
        `training.data.viewpoint.View.to_source`.
    pixels : PixelIndices
        Of m pixels, the same number of each view.
    size : (int, int)
        Height and width of the views.

    Returns
    -------
    values : float of shape (m, channels)
        Interpolated bilinearly.
    inside : bool of shape (m,)
        Whether the pixels lie inside the source images.
    """
    height, width = size
    at = torch.stack([(pixels.column + 0.5) / width, (pixels.row + 0.5) / height], dim=1)
    at = F.pad(at, (0, 1), value=1.0)
    projected = (to_source[pixels.view] @ at[:, :, None])[:, :, 0]
    position = projected[:, :2] / projected[:, 2:]
    grid = (position * 2 - 1).view(len(fields), -1, 1, 2)
    values = F.grid_sample(fields, grid, padding_mode="border", align_corners=False)[..., 0]
    return values.permute(0, 2, 1).flatten(0, 1), ((position >= 0) & (position <= 1)).all(dim=1)
