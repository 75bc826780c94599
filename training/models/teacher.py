"""The untouched trunk as a teacher: labels where it is sure, and features that tolerate a change of distance."""

import io
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.images import Image, read_rgb
from training.models.initialization import State, renamed
from worker.encoders.compact.network import CompactNetwork, fused

SURE = 0.7
"""Least probability at which the teacher's word is taken as a label."""

OPINION_CELLS = (40, 40)
"""Rows and columns that a picture's opinions are kept in, whatever its shape: about the teacher's own."""

_LONG_SIDE = 640

Floats16 = npt.NDArray[np.float16]


class Shallow(nn.Module):
    """The trunk up to stride 8 with all its blocks, frozen.

    Parameters
    ----------
    state
        Tensors under the names of ``cityscapes_trunk_fp16.npz``; deeper layers are passed over.
    """

    def __init__(self, state: State) -> None:
        super().__init__()
        whole = CompactNetwork()
        self.stride2, self.stride8 = whole.stride2, whole.stride8
        self.stride4 = whole.stride4.append(fused(24, 96, 24))
        load_own(self, renamed(state, kept_at_stride4=(0, 1, 2, 3)))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Give the layers at stride 4 (24 channels) and 8 (40 channels) of RGB pictures in 0..1."""
        at4 = self.stride4(self.stride2(images * 2 - 1))
        return at4, self.stride8(at4)


class Teacher(nn.Module):
    """The trunk as it was downloaded, with its 19 street words, frozen."""

    def __init__(self, state: State) -> None:
        super().__init__()
        whole = CompactNetwork()
        self.stride16, self.deep, self.context = whole.stride16, whole.deep, whole.context
        self.classes = nn.Conv2d(128, 19, 1)
        load_own(self, renamed(state))
        self.shallow = Shallow(state)

    def forward(self, images: Tensor) -> Tensor:
        """Give scores of the 19 street words at stride 16, for RGB pictures in 0..1."""
        scores: Tensor = self.classes(self.context(self.deep(self.stride16(self.shallow(images)[1]))))
        return scores

    @torch.inference_mode()
    def labels(self, image: Image) -> Image:
        """Label an RGB picture: uint8 of its height and width, 255 where the teacher is unsure."""
        surest, word = self._probabilities(image, image.shape[:2]).max(0)
        return np.asarray(torch.where(surest > SURE, word, 255).byte().numpy(), np.uint8)

    @torch.inference_mode()
    def opinions(self, image: Image) -> Floats16:
        """Say how likely each of the 19 words is, in cells of the whole picture: float16 (19, *OPINION_CELLS)."""
        return np.asarray(self._probabilities(image, OPINION_CELLS).half().numpy(), np.float16)

    def _probabilities(self, image: Image, size: tuple[int, ...]) -> Tensor:
        height, width = image.shape[:2]
        scale = _LONG_SIDE / max(height, width)
        across, down = (round(side * scale / 32) * 32 for side in (width, height))
        x = torch.from_numpy(cv2.resize(image, (across, down))).permute(2, 0, 1)[None].float() / 255
        x = x.contiguous(memory_format=torch.channels_last)
        scores = (self(x) + self(x.flip(3)).flip(3)) / 2
        return F.interpolate(scores, size=size, mode="bilinear", align_corners=False).softmax(1)[0]


def write_labels(teacher: Teacher, images: Iterable[Path], folder: Path) -> None:
    """Write the teacher's labels of each picture as ``<folder>/<set>__<name>.png``; what is there is kept."""
    _write_each(images, folder, label_name, lambda image: cv2.imencode(".png", teacher.labels(image))[1].tobytes())


def write_opinions(teacher: Teacher, images: Iterable[Path], folder: Path) -> None:
    """Write the teacher's opinions of each picture as ``<folder>/<set>__<name>.npy``; what is there is kept."""

    def content(image: Image) -> bytes:
        file = io.BytesIO()
        np.save(file, teacher.opinions(image))
        return file.getvalue()

    _write_each(images, folder, opinion_name, content)


def _write_each(
    images: Iterable[Path], folder: Path, name: Callable[[Path], str], content: Callable[[Image], bytes]
) -> None:
    """Write a file for each picture, whole or not at all: a run that was killed is taken up with what is there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in images:
        target = folder / name(path)
        if not target.exists():
            partial = target.with_suffix(".partial")
            partial.write_bytes(content(read_rgb(path)))
            partial.replace(target)


def opinion_name(image: Path) -> str:
    """Name the file of opinions of ``<set>/<split>/images/<name>``."""
    return f"{image.parents[2].name}__{image.stem}.npy"


def label_name(image: Path) -> str:
    """Name the label file of ``<set>/<split>/images/<name>``."""
    return f"{image.parents[2].name}__{image.stem}.png"


def load_own(module: nn.Module, state: State) -> None:
    """Load what the module has a place for, all of it, and freeze the module."""
    names = module.state_dict().keys()
    module.load_state_dict({name: tensor for name, tensor in state.items() if name in names})
    module.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
