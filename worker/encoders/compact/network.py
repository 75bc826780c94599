"""The network of the built-in encoder: one forward pass, two channels of unit-length pixel embeddings.

``CompactNetwork`` turns images into a semantic field (language-aligned: its cosines with text vectors say what a
pixel shows, and it is trained to stay the same by night and in snow) and a *detail* field (the colour and texture
that such invariance throws away), both at an eighth of the image's size. The layers up to stride 16 and the context
layers follow MobileNet-EdgeTPU (slim) with a DeepLab head; see ``docs/model-card.md`` for where the weights come from.

The module does no I/O beyond ``load_state_dict``. All convolutions carry biases and there are no batch norms: those of
the starting point were folded before training.

What ships lies in ``weights/``, written by ``training/export.py``:

``compact.safetensors``
    float16: the state dict that ``CompactNetwork.loaded`` takes, and beside it, under names that begin with ``text.``
    and are not the network's, ``text.vectors`` (n_words, 97), ``text.basis`` (512, 97) and ``text.centre`` (512,).
    The cosine of a cell's words embedding z with word i is ``text.vectors[i] @ z``: do not scale the rows, whose
    lengths below 1 belong to it. ``text.basis @ z`` is the embedding in CLIP's own 512 dimensions, and any other unit
    vector t of CLIP ViT-B/16 becomes a row as ``unit(t - text.centre) @ text.basis``.
``compact.onnx``
    The same network for ONNX Runtime, without weights: it reads them in that file. See ``training/export_onnx.py``.
``compact.json``
    SHA-256 of these files; ``words``, in the order of the rows, each with the CLIP words it stands for; provenance;
    and the files of the segmentation network, which ``worker/encoders/compact/segmentation.py`` describes.
"""

from collections.abc import Mapping
from typing import Self, TypeVar

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor, nn

Network = TypeVar("Network", bound=nn.Module)

CLIP_CHANNELS = 512
"""Channels of CLIP's text vectors, and of the words head while it is trained."""

FUSED_CHANNELS = 96
"""Channels of the layer that both the words head and its exact reduction start from."""

REDUCED_CHANNELS = FUSED_CHANNELS + 1
"""Channels of the words field as shipped: a 512-d embedding W y + b of a 96-d y spans 97 dimensions at most."""

DETAIL_CHANNELS = 64
STRIDE = 8
"""Pixels of the image per cell of both fields, along each side."""


class DeepWords(nn.Module):
    """The layers below stride 8, and how the words are read from them and from the shallow layers together."""

    def __init__(self, word_channels: int) -> None:
        super().__init__()
        self.stride16 = nn.Sequential(
            inverted(40, 320, 72, stride=2),
            *(inverted(72, 288, 72) for _ in range(3)),
            inverted(72, 576, 72, residual=False),
            *(inverted(72, 288, 72) for _ in range(3)),
        )
        self.deep = nn.Sequential(
            inverted(72, 576, 120, kernel=5), *(inverted(120, 480, 120, kernel=5, dilation=2) for _ in range(3))
        )
        self.context = Context(120)
        self.from16 = nn.Conv2d(72 + 120 + 128, FUSED_CHANNELS, 1)
        self.from8 = nn.Conv2d(40, FUSED_CHANNELS, 1)
        self.from4 = nn.Conv2d(24, FUSED_CHANNELS, 3, stride=2, padding=1)
        self.fuse = nn.Sequential(
            nn.Conv2d(FUSED_CHANNELS, FUSED_CHANNELS, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(FUSED_CHANNELS, FUSED_CHANNELS, 3, padding=1),
        )
        self.words = nn.Conv2d(FUSED_CHANNELS, word_channels, 1)

    def fused(self, at4: Tensor, at8: Tensor) -> Tensor:
        """Join depth to the shallow layers.

        Returns
        -------
        float of shape (n, 96, height at stride 8, width at stride 8)
        """
        at16 = self.stride16(at8)
        deep = self.deep(at16)
        below = self.from16(torch.cat([at16, deep, self.context(deep)], dim=1))
        below = F.interpolate(below, size=at8.shape[-2:], mode="bilinear", align_corners=False)
        joined = below + self.from8(at8) + self.from4(at4)
        return F.relu(joined + self.fuse(F.relu(joined)))

    @classmethod
    def loaded(cls, state: Mapping[str, Tensor]) -> Self:
        """Build the network for inference from a state dict of any float type, channels last, in float32."""
        return for_inference(cls(state["words.weight"].shape[0]), state)


def for_inference(network: Network, state: Mapping[str, Tensor]) -> Network:
    """Load a state dict of any float type and freeze the network, channels last, in float32."""
    network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    return network.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


class ShallowLayers(nn.Module):
    """Images to the layers at strides 2, 4 and 8."""

    def __init__(self) -> None:
        super().__init__()
        self.stride2 = nn.Sequential(Convolution(3, 24, 3, stride=2), Convolution(24, 16, activate=False))
        # The trunk had three residual blocks here: at stride 4 they cost most, and training on heals the gap.
        self.stride4 = nn.Sequential(fused(16, 128, 24, stride=2), *(fused(24, 96, 24) for _ in range(2)))
        self.stride8 = nn.Sequential(fused(24, 192, 40, stride=2), *(fused(40, 160, 40) for _ in range(3)))

    def levels(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Run the layers that everything else reads.

        Parameters
        ----------
        images : float of shape (n, 3, height, width)
            RGB in 0..1; any height and width from 32 on.

        Returns
        -------
        float of shapes (n, 16, height / 2, width / 2), (n, 24, height / 4, width / 4), (n, 40, height / 8, width / 8)
            The layers at strides 2, 4 and 8; sides rounded up.
        """
        at2 = self.stride2(images * 2 - 1)
        at4 = self.stride4(at2)
        return at2, at4, self.stride8(at4)


class CompactNetwork(DeepWords, ShallowLayers):
    """Images to two fields of unit-length embeddings at stride 8.

    Parameters
    ----------
    word_channels
        512 while training, in CLIP's own space; 97 as shipped, where every length and cosine is the same.
    """

    def __init__(self, word_channels: int = REDUCED_CHANNELS) -> None:
        super().__init__(word_channels)
        self.detail = nn.Conv2d(40 + 24, DETAIL_CHANNELS, 1)

    def shallow(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Give the `levels` that the fields are read from: strides 4 and 8."""
        _, at4, at8 = self.levels(images)
        return at4, at8

    def appearance(self, at4: Tensor, at8: Tensor) -> Tensor:
        """Read the detail field, not yet of unit length, from the shallow layers."""
        pooled = F.avg_pool2d(at4, 2, ceil_mode=True, count_include_pad=False)
        appearance: Tensor = self.detail(torch.cat([at8, pooled], dim=1))
        return appearance

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Embed every cell of 8 x 8 pixels.

        Parameters
        ----------
        images : float of shape (n, 3, height, width)
            RGB in 0..1; channels-last memory is fastest.

        Returns
        -------
        words : float of shape (n, word_channels, ceil(height / 8), ceil(width / 8))
            Unit length over the channels.
        detail : float of shape (n, 64, ceil(height / 8), ceil(width / 8))
            Unit length over the channels.
        """
        at4, at8 = self.shallow(images)
        words = self.words(self.fused(at4, at8))
        return F.normalize(words, dim=1), F.normalize(self.appearance(at4, at8), dim=1)


class Convolution(nn.Module):
    """Convolution and ReLU, padded as TensorFlow pads ``SAME``: at stride 2 more on the right and below."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        kernel: int = 1,
        *,
        stride: int = 1,
        dilation: int = 1,
        depthwise: bool = False,
        activate: bool = True,
    ) -> None:
        super().__init__()
        self.reach = (kernel - 1) * dilation
        self.stride = stride
        self.activate = activate
        self.convolution = nn.Conv2d(
            inputs,
            outputs,
            kernel,
            stride,
            padding=self.reach // 2 if stride == 1 else 0,
            dilation=dilation,
            groups=inputs if depthwise else 1,
        )

    def forward(self, maps: Tensor) -> Tensor:
        """Convolve maps of shape (n, inputs, h, w) to (n, outputs, ceil(h / stride), ceil(w / stride))."""
        if self.stride > 1:
            height, width = (self._missing(side) for side in maps.shape[-2:])
            maps = F.pad(maps, (width // 2, width - width // 2, height // 2, height - height // 2))
        maps = self.convolution(maps)
        return F.relu(maps, inplace=True) if self.activate else maps

    def _missing(self, side: int) -> int:
        steps = -(-side // self.stride) - 1
        return max(steps * self.stride + self.reach + 1 - side, 0)


class Block(nn.Module):
    """Convolutions one after the other, added to their own input when `residual`."""

    def __init__(self, *convolutions: nn.Module, residual: bool) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(*convolutions)
        self.residual = residual

    def forward(self, maps: Tensor) -> Tensor:
        """Map (n, c, h, w) to the last convolution's shape."""
        changed: Tensor = self.convolutions(maps)
        return maps + changed if self.residual else changed


class Context(nn.Module):
    """What surrounds a cell, and the whole image's mean beside it: DeepLab's head without its classes."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.last = nn.Sequential(inverted(inputs, 960, 144, dilation=2, residual=False), Convolution(144, 1280))
        self.local = Convolution(1280, 128)
        self.whole = Convolution(1280, 128)
        self.joined = Convolution(256, 128)

    def forward(self, maps: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, 128, h, w)."""
        maps = self.last(maps)
        whole = self.whole(maps.mean(dim=(2, 3), keepdim=True))
        joined: Tensor = self.joined(torch.cat([whole.expand(-1, -1, *maps.shape[2:]), self.local(maps)], dim=1))
        return joined


def fused(inputs: int, middle: int, outputs: int, *, stride: int = 1) -> Block:
    """Full 3x3 convolution to `middle` channels, then 1x1; residual where the shapes allow it."""
    return Block(
        Convolution(inputs, middle, 3, stride=stride),
        Convolution(middle, outputs, activate=False),
        residual=stride == 1 and inputs == outputs,
    )


def inverted(
    inputs: int,
    middle: int,
    outputs: int,
    *,
    kernel: int = 3,
    stride: int = 1,
    dilation: int = 1,
    residual: bool = True,
) -> Block:
    """1x1 to `middle` channels, depthwise, 1x1 back; residual where the shapes allow it unless told not to."""
    return Block(
        Convolution(inputs, middle),
        Convolution(middle, middle, kernel, stride=stride, dilation=dilation, depthwise=True),
        Convolution(middle, outputs, activate=False),
        residual=residual and stride == 1 and inputs == outputs,
    )
