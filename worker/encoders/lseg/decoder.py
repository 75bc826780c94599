"""The DPT decoder (Ranftl et al., ICCV 2021) and LSeg's head: four taps of the transformer to unit-length embeddings.

Maps run between layers as (images, channels, rows, columns) in channels-last memory, so that a convolution, a dense
layer over cells and an enlargement all read them without a copy.
"""

import torch
import torch.nn.functional as F  # noqa: N812 - the name everyone knows
from torch import Tensor, nn

from worker.encoders.lseg.config import Config
from worker.encoders.lseg.enlarge import Axis, enlarge
from worker.encoders.lseg.linear import linear

BATCH_NORM_EPS = 1e-5

HALO = 5
"""3x3 convolutions between the first reassembled map and the last enlargement: ``layer1_rn`` and two residual units.
What a cut does wrong at its edge (a zero where a neighbour was) travels one cell with each of them."""

PIXEL_SCALE = 14.2890625
"""1/0.07, CLIP's temperature before its training, rounded to half precision. It is a constant of LSeg's code: the
checkpoint's ``clip_pretrained.logit_scale`` is CLIP's own, and not used."""

Cells = tuple[int, int]
"""(rows, columns)"""


class Readout(nn.Module):
    """DPT's readout "project": each patch token is joined with the class token and projected back."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.project = nn.Sequential(nn.Linear(2 * width, width))

    def forward(self, tokens: Tensor) -> Tensor:
        """(images, 1 + patches, width), class token first, to (images, patches, width)."""
        weight, bias = self.project.get_parameter("0.weight"), self.project.get_parameter("0.bias")
        # W [patch, class] = W_left patch + W_right class, and the second term is the same for all patches.
        for_patch, for_class = weight.chunk(2, dim=1)
        shared = F.linear(tokens[:, :1], for_class, bias)
        return F.gelu(linear(tokens[:, 1:], for_patch.contiguous()) + shared)


class Reassemble(nn.ModuleDict):
    """One tap's tokens to a map of its own size. Keys are the checkpoint's positions in a sequence."""

    def __init__(self, width: int, channels: int, resample: nn.Module | None) -> None:
        super().__init__({"0": Readout(width), "3": nn.Conv2d(width, channels, 1)})
        if resample is not None:
            self["4"] = resample

    def forward(self, tokens: Tensor, grid: Cells) -> Tensor:
        """(images, 1 + rows * columns, width) to (images, channels, rows', columns')."""
        x: Tensor = self["0"](tokens)
        x = self["3"](x.view(-1, *grid, x.shape[-1]).permute(0, 3, 1, 2))
        return self["4"](x) if "4" in self else x


class FrozenBatchNorm(nn.Module):
    """Batch normalisation by the statistics of the training, which is over."""

    weight: Tensor
    bias: Tensor
    running_mean: Tensor
    running_var: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        for name in ("weight", "bias", "running_mean", "running_var"):
            self.register_buffer(name, torch.empty(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(images, channels, rows, columns) to the same shape."""
        return F.batch_norm(x, self.running_mean, self.running_var, self.weight, self.bias, eps=BATCH_NORM_EPS)


class ResidualUnit(nn.Module):
    """x + BN(conv(relu(BN(conv(relu(x))))))."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.bn1 = FrozenBatchNorm(channels)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.bn2 = FrozenBatchNorm(channels)

    def forward(self, x: Tensor) -> Tensor:
        """(images, channels, rows, columns) to the same shape."""
        y = self.bn1(self.conv1(F.relu(x)))
        change: Tensor = self.bn2(self.conv2(F.relu_(y)))
        return change.add_(x)


class Fusion(nn.Module):
    """One step of the decoder: add a tap to the path and enlarge.

    Parameters
    ----------
    channels : int
    with_tap : bool
        The deepest step has nothing to add to: its first unit is in the checkpoint, but not used.
    """

    def __init__(self, channels: int, *, with_tap: bool) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(channels, channels, 1)
        if with_tap:
            self.resConfUnit1 = ResidualUnit(channels)
        self.resConfUnit2 = ResidualUnit(channels)

    def forward(self, path: Tensor, tap: Tensor | None, rows: Axis, columns: Axis) -> Tensor:
        """Path (and tap) of shape (images, channels, rows, columns) to the enlarged path."""
        if tap is not None:
            path = self.resConfUnit1(tap).add_(path)
        # LSeg enlarges first. A 1x1 convolution with a bias and an enlargement, whose weights sum to 1, commute, and
        # this way round there is a quarter of the cells to convolve.
        path = self.out_conv(self.resConfUnit2(path))
        return enlarge(path.permute(0, 2, 3, 1), rows, columns).permute(0, 3, 1, 2)


class Decoder(nn.Module):
    """Reassembled taps to embeddings: the checkpoint's ``scratch``."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        for index, channels in enumerate(config.tap_channels, start=1):
            narrow = nn.Conv2d(channels, config.features, 3, padding=1, bias=False)
            self.add_module(f"layer{index}_rn", narrow)
            self.add_module(f"refinenet{index}", Fusion(config.features, with_tap=index < 4))
        self.head1 = nn.Conv2d(config.features, config.channels, 1)

    def forward(self, maps: list[Tensor], keep: Cells | None) -> Tensor:
        """Embeddings before normalisation.

        Parameters
        ----------
        maps : four of (images, channels, rows, columns)
            Finest first; the finest has half the output's rows and columns.
        keep : (int, int) or None
            Rows and columns of the output that are wanted, from the top left; None: all.

        Returns
        -------
        (images, channels, rows, columns)
            Twice the finest map's rows and columns, or what is kept of them.
        """
        sizes = [m.shape[2:] for m in maps]
        path = self.get_submodule("layer4_rn")(maps[3])
        for index in (4, 3, 2):
            tap = None if index == 4 else self.get_submodule(f"layer{index}_rn")(maps[index - 1])
            # LSeg says "twice". To the next tap's size is the same where that is even, and right where it is not.
            rows, columns = map(Axis.whole, path.shape[2:], sizes[index - 2])
            path = self.get_submodule(f"refinenet{index}")(path, tap, rows, columns)
        height, width = sizes[0]
        kept = keep or (2 * height, 2 * width)
        rows, columns = Axis(height, 2 * height, 0, kept[0]), Axis(width, 2 * width, 0, kept[1])
        near = (slice(None), slice(None), slice(rows.reach + HALO), slice(columns.reach + HALO))
        tap = self.get_submodule("layer1_rn")(maps[0][near])
        path = self.get_submodule("refinenet1")(path[near], tap, rows, columns)
        embeddings: Tensor = self.head1(path)
        return embeddings


def rounded_as_trained(embeddings: Tensor) -> Tensor:
    """Unit length times `PIXEL_SCALE`, both in half precision, as LSeg computes on any device.

    Parameters
    ----------
    embeddings : (images, channels, rows, columns)

    Returns
    -------
    float16 of shape (images, rows, columns, channels)
    """
    cells = F.normalize(embeddings.permute(0, 2, 3, 1).float(), dim=-1)
    return cells.half().mul_(PIXEL_SCALE)
