"""Batches of augmented views.

A batch is a function of (seed, step) alone, so that a run that is resumed sees the batches it would have seen.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from schemas.inference import STRIDE
from training.data import photometric
from training.data.images import Pixels
from training.data.lexicon import FOREGROUND, Lexicon
from training.data.mix import Mix
from training.data.pseudo_labels import Floats16, soft_labels_name
from training.data.sources import Shot, Source, read_soft_labels, read_training_image, read_training_labels
from training.data.viewpoint import (
    DETAIL_RANGE,
    LABELLED_RANGE,
    SEMANTIC_RANGE,
    View,
    ViewRange,
    draw_views,
    shared_cells,
)

POINTS = 128
"""Corresponding points drawn from each pair of views."""

MILD_SHARE = 0.8
"""Share of the labelled views without strong augmentation that get mild augmentation; the others get none."""


class Batches(Dataset[dict[str, Tensor]]):
    """Step to batch.

    A batch of n pairs of views and m labelled views holds these tensors. Where both views of a pair are meant, all
    first views come before all second views.

    - ``images``: uint8 (2n, 3, height, width), RGB;
    - ``classes``: int16 (2n, height / 4, width / 4), index into the lexicon's classes, -1 where there is no label;
    - ``sets``: int64 (2n,), index into the lexicon's sets, -1 for images without labels;
    - ``cells``: int64 (n, POINTS) and ``positions``: float32 (n, POINTS, 2), see `shared_cells`;
    - ``matched``: bool (n,), whether those two can be used;
    - ``mild``: bool (n,), whether the photometric augmentation was mild, for the detail channel;
    - ``labelled_images``, ``labelled_classes``, ``labelled_sets``: as above, of the labelled views, with a label for
      every `Mix.labelled_stride` pixels;
    - ``soft_labels``: float16 (m, 19, rows, columns), a teacher's soft labels of the whole images that the labelled
      views were cut from, 0 where it has none, and ``to_source``: float32 (m, 3, 3), the views' `View.to_source`.

    The tensors of pairs are absent when the mix has no pairs, the last two when there is no folder of soft labels.

    Parameters
    ----------
    sources : mapping of str to Source
    lexicon : Lexicon
    mix : Mix
    seed : int
    soft_labels : Path or None
        Folder written by `training.data.pseudo_labels.write_soft_labels`.
    """

    def __init__(
        self, sources: Mapping[str, Source], lexicon: Lexicon, mix: Mix, seed: int, soft_labels: Path | None = None
    ) -> None:
        self._sources = dict(sources)
        self._tables = {name: lexicon.table(name) for name in lexicon.sets}
        self._set_index = {name: index for index, name in enumerate(lexicon.sets)}
        # The last entry belongs to class -1.
        self._foreground = np.array([*(FOREGROUND.issuperset(each.labels) for each in lexicon.classes), False])
        self._mix = mix
        self._soft_labels = soft_labels
        self._seed = seed

    def __getitem__(self, step: int) -> dict[str, Tensor]:
        """Draw the batch of one step."""
        cv2.setNumThreads(1)
        rng = np.random.default_rng([self._seed, step])
        batch = self._pairs(rng) if self._mix.strong or self._mix.mild else {}
        labelled = [self._labelled_view(rng) for _ in range(self._mix.labelled)]
        batch |= {
            "labelled_images": _stacked([one.image for one in labelled]),
            "labelled_classes": torch.from_numpy(np.stack([one.classes for one in labelled])),
            "labelled_sets": torch.tensor([self._set_index.get(one.data_set, -1) for one in labelled]),
        }
        if self._soft_labels is not None:
            batch["soft_labels"] = torch.from_numpy(np.stack([one.soft_labels for one in labelled]))
            batch["to_source"] = torch.from_numpy(np.stack([one.view.to_source for one in labelled])).float()
        return batch

    def _pairs(self, rng: np.random.Generator) -> dict[str, Tensor]:
        mix = self._mix
        pairs = [
            *(self._pair(rng, mix.strong_shares, SEMANTIC_RANGE, mild=False) for _ in range(mix.strong)),
            *(self._pair(rng, mix.mild_shares, DETAIL_RANGE, mild=True) for _ in range(mix.mild)),
        ]
        views = [pair.first for pair in pairs] + [pair.second for pair in pairs]
        owners = [self._set_index.get(pair.data_set or "", -1) for pair in pairs]
        return {
            "images": _stacked([image for image, _ in views]),
            "classes": torch.from_numpy(np.stack([classes for _, classes in views])),
            "sets": torch.tensor(owners * 2),
            "cells": torch.from_numpy(np.stack([pair.cells for pair in pairs])),
            "positions": torch.from_numpy(np.stack([pair.positions for pair in pairs])),
            "matched": torch.tensor([pair.matched for pair in pairs]),
            "mild": torch.tensor([False] * mix.strong + [True] * mix.mild),
        }

    def _source(self, rng: np.random.Generator, shares: Mapping[str, float]) -> Source:
        names = [name for name in shares if name in self._sources]
        odds = np.array([shares[name] for name in names])
        return self._sources[names[rng.choice(len(names), p=odds / odds.sum())]]

    def _labelled_view(self, rng: np.random.Generator) -> "_LabelledView":
        source = self._source(rng, self._mix.labelled_shares)
        one = self._cut(rng, source)
        if self._mix.labelled_pasted and rng.random() < self._mix.labelled_pasted:
            other = self._cut(rng, source)
            pasted = self._foreground[other.classes]
            one.classes[pasted] = other.classes[pasted]
            pixels = np.kron(pasted, np.ones((self._mix.labelled_stride,) * 2, np.bool_))
            one.image[pixels] = other.image[pixels]
        if self._mix.labelled_strong and rng.random() < self._mix.labelled_strong:
            return replace(one, image=photometric.strong(one.image, rng))
        if rng.random() < MILD_SHARE:
            return replace(one, image=photometric.mild(one.image, rng))
        return one

    def _cut(self, rng: np.random.Generator, source: Source) -> "_LabelledView":
        shot, _ = source.draw(rng)
        image = read_training_image(shot.image)
        size = self._mix.labelled_size
        view, _ = draw_views(image.shape[:2], size, LABELLED_RANGE, rng, self._mix.labelled_zoom)
        classes = self._classes(shot, image, view, size, self._mix.labelled_stride)
        folder = self._soft_labels
        soft = np.zeros(0, np.float16) if folder is None else read_soft_labels(folder / soft_labels_name(shot.image))
        return _LabelledView(view.cut(image, size, labels=False), classes, source.name, view, soft)

    def _classes(
        self, shot: Shot, image: Pixels, view: View, size: tuple[int, int], stride: int = 4
    ) -> npt.NDArray[np.int16]:
        height, width = size
        if shot.labels is None or shot.data_set is None:
            return np.full((height // stride, width // stride), -1, np.int16)
        labels = view.cut(read_training_labels(shot.labels, image.shape[:2]), size, labels=True)
        return self._tables[shot.data_set][labels[stride // 2 :: stride, stride // 2 :: stride]]

    def _pair(
        self, rng: np.random.Generator, shares: Mapping[str, float], view_range: ViewRange, *, mild: bool
    ) -> "_Pair":
        shots = self._source(rng, shares).draw(rng)
        images = [read_training_image(shot.image) for shot in shots]
        height, width = self._mix.size
        views = draw_views(images[0].shape[:2], (height, width), view_range, rng)
        cells, positions, matched = shared_cells(*views, (height // STRIDE, width // STRIDE), POINTS, rng)
        ready = []
        for shot, image, view in zip(shots, images, views, strict=True):
            cut = view.cut(image, (height, width), labels=False)
            augmented = photometric.mild(cut, rng) if mild else photometric.strong(cut, rng)
            ready.append((augmented, self._classes(shot, image, view, (height, width))))
        return _Pair(ready[0], ready[1], shots[0].data_set, cells, positions, matched)


@dataclass(frozen=True)
class _LabelledView:
    image: Pixels
    classes: npt.NDArray[np.int16]
    data_set: str
    view: View
    soft_labels: Floats16


@dataclass(frozen=True)
class _Pair:
    first: tuple[Pixels, npt.NDArray[np.int16]]
    second: tuple[Pixels, npt.NDArray[np.int16]]
    data_set: str | None
    cells: npt.NDArray[np.int64]
    positions: npt.NDArray[np.float32]
    matched: bool


def _stacked(images: Sequence[Pixels]) -> Tensor:
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)


def stream(batches: Dataset[dict[str, Tensor]], start: int, workers: int) -> Iterator[dict[str, Tensor]]:
    """Give the batches from step `start` on, without end, drawn by `workers` processes (0: by this one)."""
    loader: DataLoader[dict[str, Tensor]] = DataLoader(
        batches,
        batch_size=None,
        sampler=_From(start),
        num_workers=workers,
        multiprocessing_context="spawn" if workers else None,
        prefetch_factor=4 if workers else None,
    )
    return iter(loader)


class _From:
    """The steps from `start` on, as a sampler; `DataLoader` wants a length, so it has a very large one."""

    def __init__(self, start: int) -> None:
        self._start = start

    def __iter__(self) -> Iterator[int]:
        step = self._start
        while True:
            yield step
            step += 1

    def __len__(self) -> int:
        return 2**40
