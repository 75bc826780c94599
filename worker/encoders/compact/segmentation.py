"""Segmentation networks: the semantic layer at stride 4.

`SegmentationNetwork` shares the shallow layers of `CompactNetwork` and has deep layers of its own, so that features for
segmentation need not be invariant to night and snow. Its embeddings lie in the space of the semantic layer: both use
the same text vectors. It runs only for segmentations that are shown, never for a description.

`IndependentSegmentationNetwork` shares no layer with `CompactNetwork`, so its errors differ, and the mean of several
members is better than each.

Weights lie in ``weights/compact-fine.safetensors`` (float16: the state dict of ``SegmentationNetwork(97)``) and, of two
``IndependentSegmentationNetwork(97)``, in ``compact-second.safetensors`` and ``compact-third.safetensors`` beside it,
written by ``training/commands/export_segmentation.py``.
"""

from collections.abc import Mapping
from typing import Self

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from worker.encoders.compact.network import FUSED_CHANNELS, REDUCED_CHANNELS, DeepWords, ShallowLayers, for_inference

EDGE_CHANNELS = 32
"""Channels to which `Sharpening` maps the layer at stride 2, and that at stride 4."""


class SegmentationNetwork(DeepWords):
    """Maps the shallow layers of `CompactNetwork` to embeddings at stride 4, in the space of its semantic field."""

    def __init__(self, word_channels: int = REDUCED_CHANNELS) -> None:
        super().__init__(word_channels)
        self.sharpen = Sharpening()

    def joined(self, at2: Tensor, at4: Tensor, at8: Tensor) -> Tensor:
        """Input of the semantic head: float of shape (n, 96, height / 4, width / 4)."""
        joined: Tensor = self.sharpen(at2, at4, self.fused(at4, at8))
        return joined

    def forward(self, at2: Tensor, at4: Tensor, at8: Tensor) -> Tensor:
        """Embed every cell of 4 x 4 pixels.

        Parameters
        ----------
        at2, at4, at8
            From `CompactNetwork.levels`.

        Returns
        -------
        float of shape (n, word_channels, ceil(height / 4), ceil(width / 4))
            Unit length over the channels.
        """
        return F.normalize(self.words(self.joined(at2, at4, at8)), dim=1)


class IndependentSegmentationNetwork(nn.Module):
    """A segmentation network that shares no layer with `CompactNetwork`: images straight to embeddings."""

    def __init__(self, word_channels: int = REDUCED_CHANNELS) -> None:
        super().__init__()
        self.shallow = ShallowLayers()
        self.fine = SegmentationNetwork(word_channels)

    def forward(self, images: Tensor) -> Tensor:
        """Embed every cell of 4 x 4 pixels of RGB images in 0..1; see `SegmentationNetwork.forward`."""
        words: Tensor = self.fine(*self.shallow.levels(images))
        return words

    @classmethod
    def loaded(cls, state: Mapping[str, Tensor]) -> Self:
        """Build it for inference from a state dict of any float type, channels last, in float32."""
        return for_inference(cls(state["fine.words.weight"].shape[0]), state)


class Sharpening(nn.Module):
    """Upsamples the input of the semantic head to stride 4, guided by the edges in the layers at strides 2 and 4.

    A residual on bilinear upsampling, initialised to zero.
    """

    def __init__(self) -> None:
        super().__init__()
        self.nearest = nn.Conv2d(16, EDGE_CHANNELS, 3, stride=2, padding=1)
        self.near = nn.Conv2d(24, EDGE_CHANNELS, 1)
        self.below = nn.Conv2d(FUSED_CHANNELS, 2 * EDGE_CHANNELS, 1)
        self.mix = nn.Sequential(
            nn.ReLU(inplace=True),
            nn.Conv2d(4 * EDGE_CHANNELS, 2 * EDGE_CHANNELS, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(2 * EDGE_CHANNELS, 2 * EDGE_CHANNELS, 3, padding=1),
            nn.ReLU(inplace=True),
        )
        self.out = nn.Conv2d(2 * EDGE_CHANNELS, FUSED_CHANNELS, 1)
        for parameter in self.out.parameters():
            nn.init.zeros_(parameter)

    def forward(self, at2: Tensor, at4: Tensor, joined: Tensor) -> Tensor:
        """Map (n, 16, 2h, 2w), (n, 24, h, w) and (n, 96, ceil(h / 2), ceil(w / 2)) to (n, 96, h, w)."""
        size = at4.shape[-2:]
        below = F.interpolate(self.below(joined), size=size, mode="bilinear", align_corners=False)
        mixed = self.mix(torch.cat([self.nearest(at2), self.near(at4), below], dim=1))
        enlarged = F.interpolate(joined, size=size, mode="bilinear", align_corners=False)
        sharpened: Tensor = enlarged + self.out(mixed)
        return sharpened
