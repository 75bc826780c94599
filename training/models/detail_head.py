"""A first detail head without gradient steps, and the features that its similarities are held to.

Both are linear maps fitted on a sample of training pictures, so a run loses no time on a random head.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.batches import training_image
from training.models.teacher import Shallow, load_own
from worker.encoders.compact.network import DETAIL_CHANNELS, CompactNetwork

_SIZE = (288, 384)
_EVERY = 7


class SpreadFeatures(nn.Module):
    """The teacher's layer at stride 8, centred, spread and of unit length.

    Its 40 channels vary by very different amounts; dividing each principal direction by the fourth root of its
    variance lets the quiet ones speak without drowning the loud ones in their noise.
    """

    centre: Tensor
    spread: Tensor

    def __init__(self, teacher: Shallow, images: Sequence[Path]) -> None:
        super().__init__()
        self.teacher = teacher
        sample = torch.cat([_columns(teacher(batch)[1]) for batch in _batches(images)])
        self.register_buffer("centre", sample.mean(dim=0))
        values, directions = torch.linalg.eigh(torch.cov((sample - self.centre).T))
        self.register_buffer("spread", directions / values.clamp_min(1e-9) ** 0.25)

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        """Map RGB pictures in 0..1, (n, 3, h, w), to unit-length features (n, 40, h / 8, w / 8)."""
        maps = self.teacher(images)[1].float() - self.centre[:, None, None]
        return F.normalize(torch.einsum("nchw,cd->ndhw", maps, self.spread), dim=1)


class EarlierDetail(nn.Module):
    """An earlier detail network: shallow layers of its own and a head on strides 4 and 8, frozen."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        saved = torch.load(path, map_location="cpu", weights_only=True)["net"]
        saved = {name: tensor.float() for name, tensor in saved.items()}
        self.shallow = Shallow(saved)
        self.head = nn.Conv2d(40 + 24, DETAIL_CHANNELS, 1)
        load_own(self.head, {name: saved[f"head.{name}"] for name in ("weight", "bias")})

    def forward(self, images: Tensor) -> Tensor:
        """Map RGB pictures in 0..1, (n, 3, h, w), to unit-length features (n, 64, h / 8, w / 8)."""
        return F.normalize(self.head(both_layers(*self.shallow(images))), dim=1)


@torch.no_grad()
def fit_detail_head(network: CompactNetwork, towards: nn.Module, images: Sequence[Path]) -> None:
    """Set the detail head to the linear map that comes nearest to another network's detail field."""
    given, wanted = [], []
    for batch in _batches(images):
        given.append(_columns(both_layers(*network.shallow(batch))))
        wanted.append(_columns(towards(batch)))
    inputs = torch.cat(given).double()
    inputs = torch.cat([inputs, torch.ones(len(inputs), 1, dtype=torch.float64)], dim=1)
    gram = inputs.T @ inputs
    ridge = 1e-4 * gram.diagonal().mean() * torch.eye(len(gram), dtype=torch.float64)
    solution = torch.linalg.solve(gram + ridge, inputs.T @ torch.cat(wanted).double()).T.float()
    _set_head(network, solution[:, :-1], solution[:, -1])


@torch.no_grad()
def spread_detail_head(network: CompactNetwork, images: Sequence[Path]) -> None:
    """Set the detail head to the principal directions of its inputs, each divided by its variance's fourth root."""
    inputs = torch.cat([_columns(both_layers(*network.shallow(batch))) for batch in _batches(images)]).double()
    mean = inputs.mean(dim=0)
    values, directions = torch.linalg.eigh(torch.cov((inputs - mean).T))
    matrix = (directions / values.clamp_min(1e-9) ** 0.25).T
    matrix /= ((inputs - mean) @ matrix.T).norm(dim=1).mean()
    _set_head(network, matrix.float(), -(matrix @ mean).float())


def both_layers(at4: Tensor, at8: Tensor) -> Tensor:
    """Join stride 8 and pooled stride 4: (n, 64, h / 8, w / 8), what the detail head reads."""
    return torch.cat([at8, F.avg_pool2d(at4, 2, ceil_mode=True, count_include_pad=False)], dim=1)


def _set_head(network: CompactNetwork, weight: Tensor, bias: Tensor) -> None:
    network.detail.load_state_dict({"weight": weight[:, :, None, None], "bias": bias})


def _batches(images: Sequence[Path]) -> Iterator[Tensor]:
    for path in images:
        image = cv2.resize(training_image(path), (_SIZE[1], _SIZE[0]), interpolation=cv2.INTER_AREA)
        yield torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255


def _columns(maps: Tensor) -> Tensor:
    """List every few cells of maps (1, channels, h, w) as rows (n, channels)."""
    return maps[0].flatten(1).T[::_EVERY]
