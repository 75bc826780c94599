"""Batches of crops whose tokens a teacher computed once.

A batch is a function of (seed, step) alone, as those of `training.data.batches`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from schemas.description import Floats
from training.data import photometric
from training.data.crops import Crop, crops_of, images_to_distil, token_file
from training.data.images import Pixels
from training.data.sources import read_training_image
from training.data.teacher_space import TeacherSpace
from training.data.viewpoint import View, shared_cells

POINTS = 96
"""Corresponding points drawn from each pair of views."""

CELL = 16
"""Pixels of a view per token, along either side."""

SAME_CROP = 0.3
"""Share of the pairs whose views are one crop in two lights."""

STRONG = 0.6
"""Share of the views under strong photometric augmentation; the others get the mild one."""


class Scene(NamedTuple):
    """Images of one camera pose, or one image, and how often it is drawn relative to other scenes."""

    images: tuple[Path, ...]
    weight: float


@dataclass(frozen=True)
class CropBatches(Dataset[dict[str, Tensor]]):
    """Step to batch: `pairs` pairs of views, all first views before all second ones.

    - ``images``: uint8 (2 pairs, 3, size, size), RGB, augmented;
    - ``targets``: float16 (2 pairs, channels, size / 16, size / 16), the teacher's tokens of the clean crops in the
      space that is learned, unit length; of an aligned scene the mean over both of a pair's shots;
    - ``cells``, ``positions``, ``matched``: as `training.data.batches.Batches` gives them.

    Parameters
    ----------
    scenes : sequence of Scene
    root, tokens : Path
        The data folder, and that of the cached tokens.
    space : TeacherSpace
    pairs : int
    seed : int
    """

    scenes: Sequence[Scene]
    root: Path
    tokens: Path
    space: TeacherSpace
    pairs: int
    seed: int

    def __getitem__(self, step: int) -> dict[str, Tensor]:
        """Draw the batch of one step."""
        cv2.setNumThreads(1)
        rng = np.random.default_rng([self.seed, step])
        weights = np.array([scene.weight for scene in self.scenes])
        chosen = rng.choice(len(self.scenes), self.pairs, p=weights / weights.sum())
        pairs = [self._pair(self.scenes[index], rng) for index in chosen]
        both = [pair.views[0] for pair in pairs] + [pair.views[1] for pair in pairs]
        return {
            "images": torch.from_numpy(np.stack([image for image, _ in both])).permute(0, 3, 1, 2),
            "targets": torch.from_numpy(np.stack([target for _, target in both])).permute(0, 3, 1, 2),
            "cells": torch.from_numpy(np.stack([pair.cells for pair in pairs])),
            "positions": torch.from_numpy(np.stack([pair.positions for pair in pairs])),
            "matched": torch.tensor([pair.matched for pair in pairs]),
        }

    def _pair(self, scene: Scene, rng: np.random.Generator) -> "_Pair":
        paths = [scene.images[i] for i in rng.choice(len(scene.images), 2, replace=len(scene.images) < 2)]
        images = [read_training_image(path) for path in paths]
        crops = crops_of(paths[0], self.root, (images[0].shape[0], images[0].shape[1]))
        first, second = (int(i) for i in rng.integers(len(crops), size=2))
        if rng.random() < SAME_CROP:
            second = first
        mirrored = bool(rng.random() < 0.5)
        side = self.space.side
        views = []
        for path, image, number in zip(paths, images, (first, second), strict=True):
            target = np.mean([self._target(one, number) for one in {*paths, path}], axis=0)
            pixels = crops[number].cut(image, side * CELL)
            if mirrored:
                target, pixels = target[:, ::-1], np.ascontiguousarray(pixels[:, ::-1])
            light = photometric.strong if rng.random() < STRONG else photometric.mild
            views.append((light(pixels, rng), _unit(target).astype(np.float16)))
        boxes = [_view(crops[number], mirrored) for number in (first, second)]
        cells, positions, matched = shared_cells(boxes[0], boxes[1], (side, side), POINTS, rng)
        return _Pair((views[0], views[1]), cells, positions, matched)

    def _target(self, path: Path, crop: int) -> Floats:
        tokens = np.load(token_file(path, self.root, self.tokens), mmap_mode="r")
        return self.space.project(np.asarray(tokens[crop], np.float32))


def find_scenes(data: Path) -> list[Scene]:
    """The scenes of all images to distil; a folder of a walk weighs the square root of its number of images."""
    folders: dict[Path, list[Path]] = {}
    for path in images_to_distil(data):
        folders.setdefault(path.parent, []).append(path)
    scenes = []
    for folder, images in folders.items():
        if "aligned" in folder.parts:
            large = "sped" not in folder.parts
            scenes.append(Scene(tuple(images), (len(images) ** 0.5 if large else 0.3)))
        else:
            each = 1.0 if "segmentation" in folder.parts else max(0.35, min(1.0, 4 * len(images) ** -0.5))
            scenes += [Scene((image,), each) for image in images]
    return scenes


@dataclass(frozen=True)
class _Pair:
    views: tuple[tuple[Pixels, npt.NDArray[np.float16]], tuple[Pixels, npt.NDArray[np.float16]]]
    cells: npt.NDArray[np.int64]
    positions: npt.NDArray[np.float32]
    matched: bool


def _unit(vectors: Floats) -> Floats:
    scaled: Floats = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)
    return scaled


def _view(crop: Crop, mirrored: bool) -> View:
    left, width = (crop.left + crop.width, -crop.width) if mirrored else (crop.left, crop.width)
    return View(np.array([[width, 0, left], [0, crop.height, crop.top], [0, 0, 1.0]]))
