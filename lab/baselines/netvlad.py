"""NetVLAD, the paper's comparison (Arandjelovic et al., CVPR 2016), from published weights given by a path.

VGG16 up to conv5_3 without its last ReLU and pool, soft assignment to 64 clusters, residuals added up per cluster:
32,768 numbers. Weights are never shipped. Layouts read: Nanne/pytorch-NetVlad's checkpoint (also written by several
GPUs), QVPR/Patch-NetVLAD's (its whitening is left out) and gmberton's benchmark's. The layouts are facts; no code
of theirs is used.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from lab.baselines.baseline import Tick, described, euclidean, rgb
from schemas.description import Floats
from schemas.errors import SetupError

WIDTHS = (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512)
"""Channels of VGG16's convolutions; 0 is a 2 x 2 max-pool, which drops odd rows and columns."""

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""ImageNet's, RGB in 0..1."""


class Pooling(nn.Module):
    """Soft assignment and cluster centres; named as in the published file."""

    def __init__(self, channels: int, clusters: int, bias: bool) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, clusters, 1, bias=bias)
        self.centroids = nn.Parameter(torch.zeros(clusters, channels))


class NetVlad(nn.Module):
    """The network: images in, unit vectors out.

    Parameters
    ----------
    clusters : int
    assignment_bias : bool
        The variant that its author calls vladv2.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, clusters: int = 64, assignment_bias: bool = False) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for width in WIDTHS:
            if width == 0:
                layers.append(nn.MaxPool2d(2))
                continue
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(inplace=True)]
            channels = width
        # Without the last ReLU: the features that are pooled have signs. Numbers in the names of the tensors are
        # positions in this list, so it must not be built differently.
        self.encoder = nn.Sequential(*layers[:-1])
        self.pool = Pooling(channels, clusters, assignment_bias)
        self.register_buffer("mean", torch.tensor(MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("deviation", torch.tensor(DEVIATION).view(3, 1, 1), persistent=False)

    def features(self, images: Tensor) -> Tensor:
        """Signed features, (n, 512, h // 16, w // 16), of images in 0..1, RGB, (n, 3, h, w)."""
        features: Tensor = self.encoder((images - self.mean) / self.deviation)
        return features

    def logits(self, features: Tensor) -> Tensor:
        """How much each cell belongs to each cluster, before the softmax: (n, clusters, rows, columns)."""
        logits: Tensor = self.pool.conv(functional.normalize(features, dim=1))
        return logits

    def forward(self, images: Tensor) -> Tensor:
        """Unit vectors (n, clusters * 512), cluster by cluster."""
        features = self.features(images)
        share = self.logits(features).flatten(2).softmax(dim=1)
        cells = functional.normalize(features, dim=1).flatten(2)
        # sum over x of a_k(x) (f(x) - c_k), as two products instead of an array of n x k x d x cells
        residuals = share @ cells.transpose(1, 2) - share.sum(dim=2, keepdim=True) * self.pool.centroids
        return functional.normalize(functional.normalize(residuals, dim=2).flatten(1), dim=1)


class NetVladBaseline:
    """Euclidean distance between NetVLAD vectors. Images are neither resized nor cropped.

    Parameters
    ----------
    weights : Path
    device : str

    Raises
    ------
    SetupError
        When the file is not there or not NetVLAD on VGG16.
    """

    name = "netvlad"

    def __init__(self, weights: Path, device: str = "cpu") -> None:
        self.device = device
        self.network = load(weights).to(device)

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""
        return euclidean(described(database, self.describe, tick), described(queries, self.describe, tick))

    def describe(self, path: Path) -> Floats:
        """The descriptor of an image, float32 (32768,)."""
        # One at a time: images of one batch would have to be of one size, and resizing changes the descriptor.
        pixels = torch.from_numpy(rgb(path)).permute(2, 0, 1)[None].to(self.device, torch.float32) / 255
        with torch.inference_mode():
            return np.asarray(self.network(pixels)[0].cpu().numpy(), np.float32)


def load(path: Path) -> NetVlad:
    """The network with the weights of a file, in evaluation mode, on the CPU; raises SetupError."""
    if not path.is_file():
        raise SetupError(
            f"{path}: there is no such file; NetVLAD's weights are not shipped, docs/evaluation.md says more"
        )
    tensors = _renamed(_tensors(path))
    if "pool.centroids" not in tensors:
        raise SetupError(f"{path}: no tensor pool.centroids; this is not a NetVLAD checkpoint in a layout known here")
    network = NetVlad(len(tensors["pool.centroids"]), "pool.conv.bias" in tensors)
    expected = network.state_dict()
    wrong = [f"{name} is missing" for name in expected.keys() - tensors.keys()]
    wrong += [f"{name} is not known" for name in tensors.keys() - expected.keys()]
    wrong += [
        f"{name} has shape {tuple(tensors[name].shape)}, not {tuple(expected[name].shape)}"
        for name in expected.keys() & tensors.keys()
        if tensors[name].shape != expected[name].shape
    ]
    if wrong:
        raise SetupError(f"{path} is not NetVLAD on VGG16: " + "; ".join(sorted(wrong)[:8]))
    network.load_state_dict(tensors)
    return network.eval()


def _tensors(path: Path) -> Mapping[str, Tensor]:
    """The state dict of a file, wherever in it that lies, without running anything that the file holds."""
    scalar = np.float64(0).__reduce__()[0]
    # The published file keeps its recalls as numpy scalars, under the module path of numpy 1 or of numpy 2.
    allowed: list[Any] = [
        (scalar, "numpy.core.multiarray.scalar"),
        (scalar, "numpy._core.multiarray.scalar"),
        np.dtype,
        np.dtypes.Float64DType,
    ]
    try:
        with torch.serialization.safe_globals(allowed):
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever the unpickler met
        raise SetupError(f"{path} cannot be read as a checkpoint: {str(error).splitlines()[0]}") from None
    for key in ("state_dict", "model_state_dict"):
        if isinstance(content, Mapping) and isinstance(content.get(key), Mapping):
            content = content[key]
    if not isinstance(content, Mapping):
        raise SetupError(f"{path} holds no state dict but a {type(content).__name__}")
    return {str(name): tensor for name, tensor in content.items() if isinstance(tensor, Tensor)}


def _renamed(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Names as in `NetVlad`, float32; without the whitening of Patch-NetVLAD, whose place is after the pooling."""
    found = {}
    for name, tensor in tensors.items():
        plain = re.sub(r"(^|\.)module\.", r"\1", name)
        plain = re.sub(r"^backbone\.", "encoder.", plain)
        plain = re.sub(r"^aggregation\.", "pool.", plain)
        if not plain.startswith("WPCA."):
            found[plain] = tensor.float()
    return found
