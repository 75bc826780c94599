"""The network of the built-in encoder: one forward pass, two channels of unit-length pixel embeddings.

``CompactNetwork`` maps images to a *semantic* field (language-aligned: its cosines with text vectors give the label of
a pixel, and it is trained to be invariant to night and snow) and a *detail* field (the colour and texture that this
invariance discards), both at stride 8. In this code and in the files the semantic field is named ``words``. The layers
up to stride 16 and the context layers follow MobileNet-EdgeTPU (slim) with a DeepLab head; ``docs/model-card.md`` says
where the weights come from.

The module does no I/O beyond ``load_state_dict``. All convolutions carry biases and there are no batch norms: those of
the pretrained network were folded before training.

Files in ``weights/``, written by ``training/commands/export.py``:

``compact.safetensors``
    float16: the state dict for ``CompactNetwork.loaded``, and three tensors that are not the network's:
    ``text.vectors`` (labels, 97), ``text.basis`` (512, 97) and ``text.centre`` (512,).
    The cosine of a cell's semantic embedding z with label i is ``text.vectors[i] @ z``: the rows have lengths below 1
    and must not be normalised. ``text.basis @ z`` is the embedding in CLIP's own 512 dimensions, and any other unit
    vector t of CLIP ViT-B/16 becomes a row as ``unit(t - text.centre) @ text.basis``.
``compact.onnx``
    The same network for ONNX Runtime; its weights are read from that file. See ``training/models/onnx_graphs.py``.
``compact.json``
    SHA-256 of these files; labels (``words``) in the order of the rows, each with the CLIP words it stands for;
    provenance; and the files of the segmentation networks, see ``worker/encoders/compact/segmentation.py``.
"""

from collections.abc import Mapping
from typing import Self, TypeVar

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor, nn

Network = TypeVar("Network", bound=nn.Module)

CLIP_CHANNELS = 512
"""Channels of CLIP's text vectors, and of the semantic head during training."""

FUSED_CHANNELS = 96
"""Input channels of the semantic head, in training and as shipped."""

REDUCED_CHANNELS = FUSED_CHANNELS + 1
"""Channels of the semantic field as shipped: 512-d embeddings W y + b of a 96-d y span at most 97 dimensions."""

DETAIL_CHANNELS = 64


class DeepWords(nn.Module):
    """The layers beyond stride 8, their fusion with the shallow layers, and the semantic head."""

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
        """Fuse the deep layers with those at strides 4 and 8.

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
        # The pretrained trunk has three residual blocks here; at stride 4 they cost most, and training closes the gap.
        self.stride4 = nn.Sequential(fused(16, 128, 24, stride=2), *(fused(24, 96, 24) for _ in range(2)))
        self.stride8 = nn.Sequential(fused(24, 192, 40, stride=2), *(fused(40, 160, 40) for _ in range(3)))

    def levels(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Run the shallow layers.

        Parameters
        ----------
        images : float of shape (n, 3, height, width)
            RGB in 0..1; height and width at least 32.

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
    word_channels : int
        Channels of the semantic field: 512 in training (CLIP's space), 97 as shipped, with equal lengths and cosines.
    """

    def __init__(self, word_channels: int = REDUCED_CHANNELS) -> None:
        super().__init__(word_channels)
        self.detail = nn.Conv2d(40 + 24, DETAIL_CHANNELS, 1)

    def shallow(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """The layers at strides 4 and 8, see `levels`."""
        _, at4, at8 = self.levels(images)
        return at4, at8

    def appearance(self, at4: Tensor, at8: Tensor) -> Tensor:
        """The detail field before normalisation, from the layers at strides 4 and 8."""
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
            The semantic field, unit length over the channels.
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
    """A sequence of convolutions, added to its input when `residual`."""

    def __init__(self, *convolutions: nn.Module, residual: bool) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(*convolutions)
        self.residual = residual

    def forward(self, maps: Tensor) -> Tensor:
        """Map (n, c, h, w) to the last convolution's shape."""
        changed: Tensor = self.convolutions(maps)
        return maps + changed if self.residual else changed


class Context(nn.Module):
    """Context of each cell and the mean of the whole image: DeepLab's head without its classifier."""

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
    """1x1 to `middle` channels, depthwise, 1x1 back; residual where the shapes allow it and `residual` is set."""
    return Block(
        Convolution(inputs, middle),
        Convolution(middle, middle, kernel, stride=stride, dilation=dilation, depthwise=True),
        Convolution(middle, outputs, activate=False),
        residual=residual and stride == 1 and inputs == outputs,
    )
