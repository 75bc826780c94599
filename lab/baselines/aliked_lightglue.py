"""ALIKED keypoints matched by LightGlue: learned local features and a learned matcher, to order first answers by.

Zhao et al. 2023 and Lindenberger et al. 2023. The networks are those of the package ``kornia``; the weights are the
authors' files, given by a path. Nothing is downloaded, and nothing of it is used by the service.
"""

import importlib
import re
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch

from lab.baselines.baseline import rgb
from lab.baselines.two_views import fundamental
from schemas.description import Floats
from schemas.errors import SetupError

ALIKED, LIGHTGLUE = "aliked-n16.pth", "aliked_lightglue.pth"
"""The authors' names of their files."""

KEYPOINTS = 512
"""Keypoints of an image, at most."""

LONGER_SIDE = 640
"""Pixels to which the longer side is scaled, up or down, unless said otherwise."""

REMEMBERED = 1024
"""Images whose features are kept: 270 KB each."""

WHERE = "docs/research/evaluation.md says where they can be had"


class Features(NamedTuple):
    """Keypoints of an image: pixels (1, n, 2), descriptors (1, n, 128), width and height (1, 2)."""

    keypoints: torch.Tensor
    descriptors: torch.Tensor
    size: torch.Tensor


class AlikedLightGlue:
    """Orders answers by inliers of a fundamental matrix among LightGlue's matches.

    Parameters
    ----------
    folder : Path
        Holds `ALIKED` and `LIGHTGLUE`.
    device : str
    side : int
        Pixels of the longer side.

    Raises
    ------
    SetupError
        A file is missing or is not what its name says, or ``kornia`` is not installed.
    """

    name = "aliked + lightglue"

    def __init__(self, folder: Path, device: str = "cpu", side: int = LONGER_SIDE) -> None:
        self.device, self.side = device, side
        try:
            networks: Any = importlib.import_module("kornia.feature")
        except ModuleNotFoundError as missing:
            raise SetupError(
                f"aliked + lightglue needs the package kornia, 0.9 or newer ({missing.name} is not installed): "
                "pip install kornia"
            ) from None
        self._aliked = networks.ALIKED("aliked-n16", max_num_keypoints=KEYPOINTS, detection_threshold=-1)
        self._matcher = networks.LightGlue(None, input_dim=128)
        _load(self._aliked, folder / ALIKED)
        _load(self._matcher, folder / LIGHTGLUE)
        self._aliked.eval().to(device)
        self._matcher.eval().to(device)
        self._features = lru_cache(maxsize=REMEMBERED)(self.describe)
        self._counted: dict[tuple[Path, Path], int] = {}

    def inliers(self, query: Path, image: Path) -> int:
        """Matches of two images that agree on one epipolar geometry; a pair is matched once."""
        if (query, image) not in self._counted:
            source, target = self.matches(self._features(query), self._features(image))
            self._counted[query, image] = int(fundamental(source, target).sum())
        return self._counted[query, image]

    def describe(self, path: Path) -> Features:
        """Keypoints of an image file; raises BadImage."""
        pixels = rgb(path)
        height, width = pixels.shape[:2]
        scale = self.side / max(height, width)
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        scaled = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        image = torch.from_numpy(np.ascontiguousarray(scaled)).permute(2, 0, 1)[None].to(self.device) / 255
        with torch.inference_mode():
            [found] = self._aliked(image)
        extent = torch.tensor([size], dtype=torch.float32, device=self.device)
        return Features(found.keypoints[None], found.descriptors[None], extent)

    def matches(self, query: Features, image: Features) -> tuple[Floats, Floats]:
        """Positions of what matches, float32 (matches, 2) each, as fractions of the images' longer sides."""
        names = ("keypoints", "descriptors", "image_size")
        pair = {"image0": dict(zip(names, query, strict=True)), "image1": dict(zip(names, image, strict=True))}
        with torch.inference_mode():
            [rows] = self._matcher(pair)["matches"]
        source, target = query.keypoints[0][rows[:, 0]], image.keypoints[0][rows[:, 1]]
        return (source / self.side).cpu().numpy(), (target / self.side).cpu().numpy()


def _load(network: torch.nn.Module, path: Path) -> None:
    """Read weights in their authors' layout, without running anything that the file holds."""
    if not path.is_file():
        raise SetupError(f"{path}: there is no such file; the weights are not shipped, {WHERE}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        # LightGlue's file numbers self-attention and cross-attention apart; the network has both in each layer.
        tensors = {re.sub(r"^(self_attn|cross_attn)\.(\d+)", r"transformers.\2.\1", n): t for n, t in content.items()}
        wrong = network.load_state_dict(tensors, strict=False)
    except Exception as error:  # torch raises whatever the unpickler or the shapes met
        raise SetupError(f"{path} cannot be read as weights: {str(error).splitlines()[0]}; {WHERE}") from None
    # What is computed and not learned is in no file.
    learned = {name for name, _ in network.named_parameters()}
    missing = sorted(learned & set(wrong.missing_keys)) + sorted(wrong.unexpected_keys)
    if missing:
        raise SetupError(f"{path} does not fit: {', '.join(missing[:5])}; {WHERE}")
