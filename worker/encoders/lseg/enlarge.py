"""Bilinear enlargement with aligned corners, of no more cells than will be looked at."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Axis:
    """One axis of an enlargement: cells `start` .. `stop` of the `target` that `source` cells are stretched to.

    With aligned corners the first and last cells of source and target coincide: target cell i lies at
    i (source - 1)/(target - 1) of the source.
    """

    source: int
    target: int
    start: int
    stop: int

    @classmethod
    def whole(cls, source: int, target: int) -> Self:
        """All of the target."""
        return cls(source, target, 0, target)

    @property
    def step(self) -> np.float32:
        """Source cells per target cell, in the single precision of torch.nn.functional.interpolate."""
        if self.target == 1:
            return np.float32(0)
        return np.float32(self.source - 1) / np.float32(self.target - 1)

    @property
    def reach(self) -> int:
        """How many of the source's first cells decide the target's cells before `stop`."""
        last = int(self.step * np.float32(self.stop - 1))
        return min(last + 2, self.source)

    def neighbours(self, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
        """The two source cells that each target cell lies between, and how far it is from the first, 0..1."""
        at = np.arange(self.start, self.stop, dtype=np.float32) * self.step
        low = at.astype(np.int64)
        high = np.minimum(low + 1, self.source - 1)
        there = (torch.from_numpy(a).to(device) for a in (low, high, at - low.astype(np.float32)))
        return next(there), next(there), next(there)


def interpolate_axis(maps: Tensor, axis: Axis, dimension: int, first: int = 0) -> Tensor:
    """Enlarge along one dimension.

    Parameters
    ----------
    maps : Tensor
        Along `dimension`: the source's cells from `first` to ``axis.reach`` or beyond.
    axis : Axis
    dimension, first : int

    Returns
    -------
    Tensor
        Along `dimension`: the target's cells from ``axis.start`` to ``axis.stop``.
    """
    low, high, fraction = axis.neighbours(maps.device)
    fraction = fraction.to(maps.dtype).view(-1, *[1] * (maps.ndim - dimension - 1))
    return torch.lerp(maps.index_select(dimension, low - first), maps.index_select(dimension, high - first), fraction)


def enlarge(maps: Tensor, rows: Axis, columns: Axis) -> Tensor:
    """Enlarge maps of shape (images, rows, columns, channels) along both sides."""
    return interpolate_axis(interpolate_axis(maps, rows, 1), columns, 2)
