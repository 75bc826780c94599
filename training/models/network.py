"""The network while it is trained: `CompactNetwork` with a refinement, through which labels are learned at stride 4.

At stride 4 thin objects are still seen, so labels teach more there. The refinement is not exported.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from worker.encoders.compact.network import CLIP_CHANNELS, FUSED_CHANNELS, CompactNetwork

REFINED_CHANNELS = 24
"""Channels of either input of the refinement."""

REFINEMENT_PREFIX = "refine."
"""How the names of the refinement's parameters begin."""


class TrainedNetwork(CompactNetwork):
    """The network with its semantic head in CLIP's own 512 dimensions, and with the refinement at stride 4."""

    def __init__(self) -> None:
        super().__init__(CLIP_CHANNELS)
        self.refine = Refinement(24, FUSED_CHANNELS, REFINED_CHANNELS)

    def refined(self, images: Tensor) -> Tensor:
        """Give the input of the semantic head at stride 4.

        Parameters
        ----------
        images : float of shape (n, 3, height, width)
            RGB in 0..1.

        Returns
        -------
        float of shape (n, 96, ceil(height / 4), ceil(width / 4))
        """
        at4, at8 = self.shallow(images)
        refined: Tensor = self.refine(at4, self.fused(at4, at8))
        return refined


class Refinement(nn.Module):
    """Enlarges the input of the semantic head to stride 4 and adds detail from the layer at stride 4.

    What it adds to the bilinear enlargement is 0 before training.
    """

    def __init__(self, near: int, joined: int, middle: int) -> None:
        super().__init__()
        self.near = nn.Conv2d(near, middle, 1)
        self.below = nn.Conv2d(joined, middle, 1)
        self.mix = nn.Conv2d(2 * middle, 2 * middle, 3, padding=1)
        self.out = nn.Conv2d(2 * middle, joined, 1)
        for parameter in self.out.parameters():
            nn.init.zeros_(parameter)

    def forward(self, at4: Tensor, joined: Tensor) -> Tensor:
        """Map (n, near, h, w) and (n, joined, ceil(h / 2), ceil(w / 2)) to (n, joined, h, w)."""
        size = at4.shape[-2:]
        below = F.interpolate(self.below(joined), size=size, mode="bilinear", align_corners=False)
        mixed = F.relu(self.mix(F.relu(torch.cat([self.near(at4), below], dim=1))))
        enlarged = F.interpolate(joined, size=size, mode="bilinear", align_corners=False)
        refined: Tensor = enlarged + self.out(mixed)
        return refined
