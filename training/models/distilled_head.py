"""A head that learns a teacher's tokens, on the layers of the exported network; a study, which does not ship.

`docs/research/model-card.md` says what it gave. It would be a third field of the encoder, from the same pass.
"""

from collections.abc import Mapping
from typing import Self

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from worker.encoders.compact.network import CompactNetwork, for_inference

DISTILLED_CHANNELS = 64


class Mixing(nn.Module):
    """Mixes cells with their neighbours, with the whole image, and their channels, each added to its input.

    Attention (Vaswani et al. 2017) reads keys and values at half resolution (Wang et al. 2021, "Pyramid Vision
    Transformer"), and a depthwise convolution stands for position codes (Chu et al. 2021).

    Parameters
    ----------
    channels : int
        A multiple of `heads`.
    heads : int
    ratio : int
        Width of the hidden layer of the channel mixing, relative to `channels`.
    """

    def __init__(self, channels: int, heads: int = 4, ratio: int = 2) -> None:
        super().__init__()
        self.heads = heads
        self.near = nn.Conv2d(channels, channels, 5, padding=2, groups=channels)
        self.query = nn.Conv2d(channels, channels, 1)
        self.key_value = nn.Conv2d(channels, 2 * channels, 1)
        self.attended = nn.Conv2d(channels, channels, 1)
        self.widen = nn.Conv2d(channels, ratio * channels, 1)
        self.narrow = nn.Conv2d(ratio * channels, channels, 1)
        self.norm_far = nn.LayerNorm(channels)
        self.norm_own = nn.LayerNorm(channels)

    def forward(self, maps: Tensor) -> Tensor:
        """Map (n, channels, h, w) to the same shape."""
        maps = maps + self.near(maps)
        maps = maps + self._attention(_over_channels(self.norm_far, maps))
        own: Tensor = self.narrow(F.relu(self.widen(_over_channels(self.norm_own, maps))))
        return maps + own

    def _attention(self, maps: Tensor) -> Tensor:
        half = F.avg_pool2d(maps, 2, ceil_mode=True, count_include_pad=False)
        key, value = self._by_head(self.key_value(half)).chunk(2, dim=2)
        query = self._by_head(self.query(maps))
        weights = (query.transpose(2, 3) @ key * query.shape[2] ** -0.5).softmax(dim=3)
        attended: Tensor = self.attended((value @ weights.transpose(2, 3)).reshape(maps.shape))
        return attended

    def _by_head(self, maps: Tensor) -> Tensor:
        """Map (n, heads * c, h, w) to (n, heads, c, h * w)."""
        return maps.reshape(maps.shape[0], self.heads, maps.shape[1] // self.heads, -1)


class DistilledHead(nn.Module):
    """A field at stride 16 from the layers at strides 8 and 16 and the context layers of a network."""

    def __init__(self, channels: int = 192, blocks: int = 4) -> None:
        super().__init__()
        self.from8 = nn.Conv2d(40, channels, 3, stride=2, padding=1)
        self.from16 = nn.Conv2d(72 + 120 + 128, channels, 1)
        self.blocks = nn.Sequential(*(Mixing(channels) for _ in range(blocks)))
        self.norm = nn.LayerNorm(channels)
        self.out = nn.Conv2d(channels, DISTILLED_CHANNELS, 1)

    @classmethod
    def loaded(cls, state: Mapping[str, Tensor]) -> Self:
        """Build the head for inference from a state dict of any float type, in float32."""
        return for_inference(cls(), state)

    def forward(self, at8: Tensor, at16: Tensor) -> Tensor:
        """Map what `layers_below` gives to (n, 64, ceil(h / 2), ceil(w / 2)), not yet of unit length."""
        mixed = self.blocks(self.from8(at8) + self.from16(at16))
        field: Tensor = self.out(_over_channels(self.norm, mixed))
        return field


def layers_below(network: CompactNetwork, images: Tensor) -> tuple[Tensor, Tensor]:
    """What the head reads of a network.

    Parameters
    ----------
    network : CompactNetwork
    images : float of shape (n, 3, height, width)
        RGB in 0..1.

    Returns
    -------
    float of shapes (n, 40, h, w) and (n, 320, ceil(h / 2), ceil(w / 2))
        The layer at stride 8; the layer at stride 16 with the deep and the context ones.
    """
    _, at8 = network.shallow(images)
    at16 = network.stride16(at8)
    deep = network.deep(at16)
    return at8, torch.cat([at16, deep, network.context(deep)], dim=1)


def _over_channels(norm: nn.LayerNorm, maps: Tensor) -> Tensor:
    """Normalise each cell of (n, channels, h, w)."""
    normed: Tensor = norm(maps.permute(0, 2, 3, 1))
    return normed.permute(0, 3, 1, 2)
