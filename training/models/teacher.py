"""The pretrained trunk as a frozen teacher: pseudo-labels, soft labels, features that tolerate changes of scale."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.images import Pixels
from training.data.pseudo_labels import SOFT_LABEL_GRID, Floats16
from training.models.checkpoints import State
from training.models.initialization import renamed
from worker.encoders.compact.network import CompactNetwork, fused

CONFIDENT = 0.7
"""Least probability from which the teacher's most probable class becomes a pixel's pseudo-label."""

_LONG_SIDE = 640


class TeacherFeatures(nn.Module):
    """The trunk up to stride 8 with all its blocks, frozen.

    Parameters
    ----------
    state : dict of str to Tensor
        Under the names of ``cityscapes_trunk_fp16.npz``; deeper layers are passed over.
    """

    def __init__(self, state: State) -> None:
        super().__init__()
        whole = CompactNetwork()
        self.stride2, self.stride8 = whole.stride2, whole.stride8
        self.stride4 = whole.stride4.append(fused(24, 96, 24))
        load_frozen(self, renamed(state, kept_at_stride4=(0, 1, 2, 3)))

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Give the layers at strides 4 and 8.

        Parameters
        ----------
        images : float of shape (n, 3, height, width)
            RGB in 0..1.

        Returns
        -------
        float of shapes (n, 24, height / 4, width / 4), (n, 40, height / 8, width / 8)
        """
        at4 = self.stride4(self.stride2(images * 2 - 1))
        return at4, self.stride8(at4)


class Teacher(nn.Module):
    """The trunk as it was published, with its 19 Cityscapes classes, frozen.

    Parameters
    ----------
    state : dict of str to Tensor
        Under the names of ``cityscapes_trunk_fp16.npz``.
    """

    def __init__(self, state: State) -> None:
        super().__init__()
        whole = CompactNetwork()
        self.stride16, self.deep, self.context = whole.stride16, whole.deep, whole.context
        self.classes = nn.Conv2d(128, 19, 1)
        load_frozen(self, renamed(state))
        self.shallow = TeacherFeatures(state)

    def forward(self, images: Tensor) -> Tensor:
        """Map RGB images in 0..1, float (n, 3, height, width), to logits (n, 19, height / 16, width / 16)."""
        logits: Tensor = self.classes(self.context(self.deep(self.stride16(self.shallow(images)[1]))))
        return logits

    @torch.inference_mode()
    def label_map(self, image: Pixels) -> Pixels:
        """Label an RGB image: uint8 of shape (height, width), 255 where no class reaches CONFIDENT."""
        probability, label = self._probabilities(image, image.shape[:2]).max(0)
        return np.asarray(torch.where(probability > CONFIDENT, label, 255).byte().numpy(), np.uint8)

    @torch.inference_mode()
    def soft_labels(self, image: Pixels) -> Floats16:
        """Give the probabilities of all classes over an RGB image: float16 of shape (19, *SOFT_LABEL_GRID)."""
        return np.asarray(self._probabilities(image, SOFT_LABEL_GRID).half().numpy(), np.float16)

    def _probabilities(self, image: Pixels, size: tuple[int, ...]) -> Tensor:
        height, width = image.shape[:2]
        scale = _LONG_SIDE / max(height, width)
        across, down = (round(side * scale / 32) * 32 for side in (width, height))
        x = torch.from_numpy(cv2.resize(image, (across, down))).permute(2, 0, 1)[None].float() / 255
        x = x.contiguous(memory_format=torch.channels_last)
        logits = (self(x) + self(x.flip(3)).flip(3)) / 2
        return F.interpolate(logits, size=size, mode="bilinear", align_corners=False).softmax(1)[0]


def load_frozen(module: nn.Module, state: State) -> None:
    """Load those tensors that the module has, which must be all of its own, and freeze the module."""
    names = module.state_dict().keys()
    module.load_state_dict({name: tensor for name, tensor in state.items() if name in names})
    module.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
