"""The network while it is trained: `CompactNetwork`, and a small head through which its words are taught at stride 4.

Labels of larger views teach more where thin things are still seen. What ships has no such head: segmentations are drawn
from `worker.encoders.compact.segmentation.SegmentationNetwork`.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from worker.encoders.compact.network import CLIP_CHANNELS, FUSED_CHANNELS, CompactNetwork

REFINED_CHANNELS = 24
"""Channels of either input of the layer that sharpens the words field at stride 4."""

TAUGHT_THROUGH = "refine."
"""How the names of that layer's parameters begin."""


class TrainedNetwork(CompactNetwork):
    """The network with its words head in CLIP's own space, and with the layer that sharpens them."""

    def __init__(self) -> None:
        super().__init__(CLIP_CHANNELS)
        self.refine = Refinement(24, FUSED_CHANNELS, REFINED_CHANNELS)

    def sharp(self, images: Tensor) -> Tensor:
        """Give what the words head reads at stride 4: (n, 96, ceil(height / 4), ceil(width / 4))."""
        at4, at8 = self.shallow(images)
        sharpened: Tensor = self.refine(at4, self.fused(at4, at8))
        return sharpened


class Refinement(nn.Module):
    """Enlarges the layer that the words head reads to stride 4, and sharpens it with what stride 4 still shows.

    It adds to a bilinear enlargement, and adds nothing before training.
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
        sharpened: Tensor = enlarged + self.out(mixed)
        return sharpened
