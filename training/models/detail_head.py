"""The detail head before its first step, and the teacher's features whose cosines the detail channel keeps.

Both are linear maps fitted to a sample of training images, so that a run loses no time on a random head.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.sources import read_training_image
from training.models.teacher import TeacherFeatures, load_frozen
from worker.encoders.compact.network import DETAIL_CHANNELS, CompactNetwork

_SIZE = (288, 384)
_EVERY = 7
"""Of the cells of an image in the sample, one in so many."""


class HalfWhitenedFeatures(nn.Module):
    """The teacher's layer at stride 8, centred, half-whitened and of unit length.

    Its 40 channels vary by very different amounts. Each principal component is divided by the fourth root of its
    variance, so that those of little variance count too without their noise drowning the others.

    Parameters
    ----------
    teacher : TeacherFeatures
    images : sequence of Path
        Sample from which mean and components are taken.
    """

    center: Tensor
    matrix: Tensor

    def __init__(self, teacher: TeacherFeatures, images: Sequence[Path]) -> None:
        super().__init__()
        self.teacher = teacher
        sample = torch.cat([_rows(teacher(image)[1]) for image in _read_all(images)])
        self.register_buffer("center", sample.mean(dim=0))
        values, directions = torch.linalg.eigh(torch.cov((sample - self.center).T))
        self.register_buffer("matrix", directions / values.clamp_min(1e-9) ** 0.25)

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        """Map RGB images in 0..1, float (n, 3, h, w), to unit-length features (n, 40, h / 8, w / 8)."""
        maps = self.teacher(images)[1].float() - self.center[:, None, None]
        return F.normalize(torch.einsum("nchw,cd->ndhw", maps, self.matrix), dim=1)


class PretrainedDetail(nn.Module):
    """A detail network from before this training: shallow layers of its own and a head on strides 4 and 8, frozen."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        saved = torch.load(path, map_location="cpu", weights_only=True)["net"]
        saved = {name: tensor.float() for name, tensor in saved.items()}
        self.shallow = TeacherFeatures(saved)
        self.head = nn.Conv2d(40 + 24, DETAIL_CHANNELS, 1)
        load_frozen(self.head, {name: saved[f"head.{name}"] for name in ("weight", "bias")})

    def forward(self, images: Tensor) -> Tensor:
        """Map RGB images in 0..1, float (n, 3, h, w), to unit-length features (n, 64, h / 8, w / 8)."""
        return F.normalize(self.head(_head_inputs(*self.shallow(images))), dim=1)


@torch.no_grad()
def fit_detail_head(network: CompactNetwork, target: nn.Module, images: Sequence[Path]) -> None:
    """Set the detail head to the least-squares fit to another network's detail field (ridge regression)."""
    given, wanted = [], []
    for image in _read_all(images):
        given.append(_rows(_head_inputs(*network.shallow(image))))
        wanted.append(_rows(target(image)))
    inputs = torch.cat(given).double()
    inputs = torch.cat([inputs, torch.ones(len(inputs), 1, dtype=torch.float64)], dim=1)
    gram = inputs.T @ inputs
    ridge = 1e-4 * gram.diagonal().mean() * torch.eye(len(gram), dtype=torch.float64)
    solution = torch.linalg.solve(gram + ridge, inputs.T @ torch.cat(wanted).double()).T.float()
    _set_head(network, solution[:, :-1], solution[:, -1])


@torch.no_grad()
def half_whiten_detail_head(network: CompactNetwork, images: Sequence[Path]) -> None:
    """Set the detail head to the principal components of its inputs, each divided by its variance's fourth root."""
    inputs = torch.cat([_rows(_head_inputs(*network.shallow(image))) for image in _read_all(images)]).double()
    mean = inputs.mean(dim=0)
    values, directions = torch.linalg.eigh(torch.cov((inputs - mean).T))
    matrix = (directions / values.clamp_min(1e-9) ** 0.25).T
    matrix /= ((inputs - mean) @ matrix.T).norm(dim=1).mean()
    _set_head(network, matrix.float(), -(matrix @ mean).float())


def _head_inputs(at4: Tensor, at8: Tensor) -> Tensor:
    """Join stride 8 and pooled stride 4: (n, 64, h / 8, w / 8), what the detail head reads."""
    return torch.cat([at8, F.avg_pool2d(at4, 2, ceil_mode=True, count_include_pad=False)], dim=1)


def _set_head(network: CompactNetwork, weight: Tensor, bias: Tensor) -> None:
    network.detail.load_state_dict({"weight": weight[:, :, None, None], "bias": bias})


def _read_all(images: Sequence[Path]) -> Iterator[Tensor]:
    """Read images as float RGB in 0..1 of shape (1, 3, *_SIZE)."""
    for path in images:
        image = cv2.resize(read_training_image(path), (_SIZE[1], _SIZE[0]), interpolation=cv2.INTER_AREA)
        yield torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255


def _rows(maps: Tensor) -> Tensor:
    """List every few cells of maps (1, channels, h, w) as rows (n, channels)."""
    return maps[0].flatten(1).T[::_EVERY]
