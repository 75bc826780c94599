"""Covering an image with the network: by overlapping windows, as the paper's code does, or in a single pass.

Windows: the image is resized so that its longer side is `Config.base`, padded with black to at least one window,
cut into windows `Config.stride` apart, and the windows' embeddings are averaged where they overlap. Single: the image
is resized to the nearest size that the network takes whole, and goes through it once.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor

from schemas.image import Bytes2D
from worker.encoders.lseg.config import Config
from worker.encoders.lseg.decoder import Cells
from worker.encoders.lseg.enlarge import Axis, interpolate_axis

BLACK = -1.0
"""Value of a black pixel, (0 - 0.5)/0.5: what windows are padded with."""

ROWS_AT_ONCE = 32
"""Rows that are enlarged together: few enough that intermediate arrays stay small beside the field."""


@dataclass(frozen=True)
class Input:
    """One tensor for the network.

    Parameters
    ----------
    pixels : float32 of shape (3, height, width)
        RGB in [-1, 1].
    keep : (int, int)
        Rows and columns of the network's output that are used.
    """

    pixels: Tensor
    keep: Cells


class Covering(Protocol):
    """Turns an image into inputs of the network, and the outputs into the image's field."""

    def inputs(self, pixels: Bytes2D) -> Iterator[Input]:
        """The inputs for an image of shape (height, width, 3)."""
        ...

    def join(self, size: Cells, outputs: Iterator[Tensor]) -> Tensor:
        """The field of an image of (height, width), from as many outputs as it had inputs.

        Parameters
        ----------
        size : (int, int)
        outputs : iterator of float16 of shape (rows, columns, channels)
            `Network`'s, at half the inputs' resolution.

        Returns
        -------
        float32 of shape (rows, columns, channels)
            Raw, not normalised.
        """
        ...


def resized(pixels: Bytes2D, size: Cells) -> Tensor:
    """An image of another size, as the network reads it.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    size : (int, int)
        (height, width) of the result.

    Returns
    -------
    float32 of shape (3, height, width)
        In [-1, 1]: (v/255 - 0.5)/0.5. Bilinear with aligned corners and no anti-aliasing.
    """
    rows, columns = map(Axis.whole, pixels.shape[:2], size)
    top, bottom, down = rows.neighbours(torch.device("cpu"))
    # Rows are picked before they become floats: a photo of 50 megapixels would take 600 MB as floats.
    between = torch.lerp(_floats(pixels[top.numpy()]), _floats(pixels[bottom.numpy()]), down[:, None, None])
    return interpolate_axis(between, columns, 1).permute(2, 0, 1)


def _floats(pixels: Bytes2D) -> Tensor:
    """0..255 to [-1, 1]."""
    return torch.from_numpy(pixels).float().div_(255).sub_(0.5).div_(0.5)


def rounded(value: float) -> int:
    """The nearest integer, halves upwards (Python's round takes halves to the even one)."""
    return int(value + 0.5)


class Windows:
    """The routine of the paper's code: one scale, no mirror image."""

    def __init__(self, config: Config) -> None:
        self.base, self.crop, self.stride = config.base, config.crop, config.stride

    def grid(self, size: Cells) -> Cells:
        """(rows, columns) of the field of an image of (height, width): its longer side is the base."""
        height, width = size
        if height > width:
            return self.base, max(1, rounded(width * self.base / height))
        return max(1, rounded(height * self.base / width)), self.base

    def starts(self, length: int) -> list[int]:
        """First cells of the windows along an axis of the field."""
        beyond = max(length - self.crop, 0)
        return [index * self.stride for index in range(-(-beyond // self.stride) + 1)]

    def places(self, grid: Cells) -> Iterator[tuple[slice, slice]]:
        """The true part of each window: its rows and columns of the field, without padding."""
        for top, left in itertools.product(self.starts(grid[0]), self.starts(grid[1])):
            yield slice(top, min(top + self.crop, grid[0])), slice(left, min(left + self.crop, grid[1]))

    def inputs(self, pixels: Bytes2D) -> Iterator[Input]:
        """One input per window, row by row."""
        grid = self.grid((pixels.shape[0], pixels.shape[1]))
        image = resized(pixels, grid)
        for rows, columns in self.places(grid):
            part = image[:, rows, columns]
            padding = (0, self.crop - part.shape[2], 0, self.crop - part.shape[1])
            keep = (self._axis(rows).reach, self._axis(columns).reach)
            yield Input(F.pad(part, padding, value=BLACK), keep)

    def _axis(self, cells: slice) -> Axis:
        """From the head's resolution to the window's, as far as its true part goes."""
        return Axis(self.crop // 2, self.crop, 0, cells.stop - cells.start)

    def join(self, size: Cells, outputs: Iterator[Tensor]) -> Tensor:
        """The mean, at each cell, of the windows that cover it; lengths are left as they come out."""
        grid = self.grid(size)
        first = next(outputs)
        field = torch.zeros(*grid, first.shape[-1], device=first.device)
        times = torch.zeros(*grid, 1, device=first.device)
        for (rows, columns), output in zip(self.places(grid), itertools.chain([first], outputs), strict=False):
            self._add(output, field[rows, columns], self._axis(rows), self._axis(columns))
            times[rows, columns] += 1
        return field.div_(times)

    def _add(self, output: Tensor, field: Tensor, rows: Axis, columns: Axis) -> None:
        """Enlarge a window's output and add its true part to the field in place, a few rows at a time."""
        for start in range(0, rows.stop, ROWS_AT_ONCE):
            band = Axis(rows.source, rows.target, start, min(start + ROWS_AT_ONCE, rows.stop))
            first = int(band.step * np.float32(start))
            near = output[first : band.reach, : columns.reach].float()
            field[band.start : band.stop] += interpolate_axis(interpolate_axis(near, band, 0, first), columns, 1)


class Single:
    """One unpadded pass at the image's own aspect: not the reference's numbers, for a fraction of its work.

    The field stays at the head's resolution, half the base: nothing is known at finer cells, and the reference's
    last enlargement multiplies memory by four.
    """

    def __init__(self, config: Config) -> None:
        self.windows, self.patch = Windows(config), config.patch

    def input_size(self, size: Cells) -> Cells:
        """The sides of `Windows.grid`, each rounded to whole patches."""
        rows, columns = (max(1, rounded(side / self.patch)) * self.patch for side in self.windows.grid(size))
        return rows, columns

    def inputs(self, pixels: Bytes2D) -> Iterator[Input]:
        """One input."""
        rows, columns = self.input_size((pixels.shape[0], pixels.shape[1]))
        yield Input(resized(pixels, (rows, columns)), (rows // 2, columns // 2))

    def join(self, size: Cells, outputs: Iterator[Tensor]) -> Tensor:
        """The output itself."""
        return next(outputs).float()
