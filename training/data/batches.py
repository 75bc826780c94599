"""What training sees: labelled pictures, unlabelled ones, scenes under several lights, and batches drawn from them.

A batch is a function of (seed, step) alone, so a run that is resumed sees what it would have seen.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from training.data import photometric as light
from training.data.images import Image, read_labels, read_rgb
from training.data.lexicon import IN_FRONT, STREET_WORDS, Lexicon, class_words
from training.data.mix import STREET, Mix
from training.data.viewpoint import FOR_DETAIL, FOR_LABELS, FOR_WORDS, Freedom, View, draw_views, shared_cells
from training.models.teacher import OPINION_CELLS, label_name, opinion_name
from worker.encoders.compact.network import STRIDE

LABELLED = ("camvid", "labelmefacade", "nyuv2", "ade_outdoor")
OUTDOOR = ("camvid", "labelmefacade", "ade_outdoor")
CLIP_FILE = Path("text") / "words_ViT-B-16.npz"
POINTS = 128
"""Cells drawn from each pair of views."""

MILDLY_LIT = 0.8
"""Share of the single labelled views whose light is changed at all."""

_SHORT_SIDE = 360
_LEAST_SIDE = 150


@dataclass(frozen=True)
class Shot:
    """One picture, and its labels where it has some."""

    image: Path
    labels: Path | None = None
    data_set: str | None = None


@dataclass(frozen=True)
class Source:
    """Scenes of one kind; shots of one scene were taken by one fixed camera, so that pixels correspond."""

    name: str
    scenes: Sequence[Sequence[Shot]]
    weights: npt.NDArray[np.float64]

    def draw(self, rng: np.random.Generator) -> tuple[Shot, Shot]:
        """Draw a scene and two of its shots, the same one twice when there is no other."""
        scene = self.scenes[rng.choice(len(self.scenes), p=self.weights)]
        if len(scene) == 1:
            return scene[0], scene[0]
        first, second = rng.choice(len(scene), 2, replace=False)
        return scene[first], scene[second]


def sources(data: Path, teacher_labels: Path | None, splits: Sequence[str] = ("train",)) -> dict[str, Source]:
    """Find everything to train on below `data`: of labelled sets the pictures of `splits`."""
    found: dict[str, Source] = {}
    for data_set in LABELLED:
        shots = [
            Shot(image, labels_of(image), data_set)
            for split in splits
            for image in images_of(data / "segmentation", data_set, split)
        ]
        found[data_set] = _evenly(data_set, [[shot] for shot in shots])
    if teacher_labels is not None:
        taught = [
            Shot(image, teacher_labels / label_name(image), STREET)
            for data_set in OUTDOOR
            for image in training_images(data / "segmentation", data_set)
        ]
        found[STREET] = _evenly(STREET, [[shot] for shot in taught])
    indoor = _by_folder(data / "unlabelled")
    if indoor:
        # A few long walks make up most of these: weigh a folder by the square root of its size.
        walks = [(len(walk), Shot(image)) for walk in indoor for image in walk]
        found["indoor"] = _weighted("indoor", [[shot] for _, shot in walks], [size**-0.5 for size, _ in walks])
    aligned = [_one_size(folder) for folder in _by_folder(data / "pairs" / "aligned")]
    scenes = [(side, [Shot(image) for image in scene]) for side, scene in aligned if len(scene) > 1]
    if scenes:
        trust = [len(scene) ** 0.5 * (1.0 if side > _LEAST_SIDE else 0.15) for side, scene in scenes]
        found["aligned"] = _weighted("aligned", [scene for _, scene in scenes], trust)
    return {name: source for name, source in found.items() if len(source.scenes)}


def classes(data: Path) -> dict[str, dict[int, Sequence[str]]]:
    """Give the words of every label value of every labelled set, the trunk's own labels among them."""
    files = {name: data / "segmentation" / name / "classes.json" for name in LABELLED}
    attributes = {name: class_words(path) for name, path in files.items() if path.exists()}
    return attributes | {STREET: {value: (word,) for value, word in enumerate(STREET_WORDS)}}


def images_of(segmentation: Path, data_set: str, split: str) -> list[Path]:
    """List the pictures of a labelled set that belong to a split: ``train``, ``val`` or ``test``."""
    return sorted((segmentation / data_set / split / "images").glob("*"))


def training_images(segmentation: Path, data_set: str) -> list[Path]:
    """List the training pictures of a labelled set."""
    return images_of(segmentation, data_set, "train")


class Batches(Dataset[dict[str, Tensor]]):
    """Step to batch.

    A batch of n pairs holds, first views before second views where both are meant:

    - ``images``: uint8 (2n, 3, height, width), RGB;
    - ``meanings``: int16 (2n, height / 4, width / 4), -1 where nothing is known;
    - ``sets``: int64 (2n,), index into the lexicon's sets, -1 for pictures without labels;
    - ``cells``: int64 (n, POINTS) and ``positions``: float32 (n, POINTS, 2), see `shared_cells`;
    - ``matched``: bool (n,), whether those can be used;
    - ``mild``: bool (n,), whether the light was changed mildly, for the detail channel;
    - ``clear_images``, ``clear_meanings``, ``clear_sets``: the same of the single labelled views, with labels at the
      mix's own stride; these alone, where the mix has no pairs;
    - ``clear_opinions``: float16 (n, 19, rows, columns), a teacher's opinions of the pictures that those were cut from,
      0 where it has none, and ``clear_views``: float32 (n, 3, 3), from a view to its picture; where there is a folder
      of opinions.
    """

    def __init__(
        self, found: Mapping[str, Source], lexicon: Lexicon, mix: Mix, seed: int, opinions: Path | None = None
    ) -> None:
        self._found = dict(found)
        self._tables = {name: lexicon.table(name) for name in lexicon.sets}
        self._set_index = {name: index for index, name in enumerate(lexicon.sets)}
        self._in_front = np.array([*(IN_FRONT.issuperset(meaning.words) for meaning in lexicon.meanings), False])
        self._mix = mix
        self._opinions = opinions
        self._seed = seed

    def __getitem__(self, step: int) -> dict[str, Tensor]:
        """Draw the batch of one step."""
        cv2.setNumThreads(1)
        rng = np.random.default_rng([self._seed, step])
        batch = self._pairs(rng) if self._mix.strong or self._mix.mild else {}
        clear = [self._clear(rng) for _ in range(self._mix.clear)]
        batch |= {
            "clear_pictures": _stacked([one.image for one in clear]),
            "clear_meanings": torch.from_numpy(np.stack([one.meanings for one in clear])),
            "clear_sets": torch.tensor([self._set_index.get(one.data_set, -1) for one in clear]),
        }
        if self._opinions is not None:
            batch["clear_opinions"] = torch.from_numpy(np.stack([one.opinions for one in clear]))
            batch["clear_views"] = torch.from_numpy(np.stack([one.view.to_source for one in clear])).float()
        return batch

    def _pairs(self, rng: np.random.Generator) -> dict[str, Tensor]:
        mix = self._mix
        pairs = [
            *(self._pair(rng, mix.strong_shares, FOR_WORDS, mild=False) for _ in range(mix.strong)),
            *(self._pair(rng, mix.mild_shares, FOR_DETAIL, mild=True) for _ in range(mix.mild)),
        ]
        views = [pair.first for pair in pairs] + [pair.second for pair in pairs]
        owners = [self._set_index.get(pair.data_set or "", -1) for pair in pairs]
        return {
            "pictures": _stacked([image for image, _ in views]),
            "meanings": torch.from_numpy(np.stack([meanings for _, meanings in views])),
            "sets": torch.tensor(owners * 2),
            "cells": torch.from_numpy(np.stack([pair.cells for pair in pairs])),
            "positions": torch.from_numpy(np.stack([pair.positions for pair in pairs])),
            "matched": torch.tensor([pair.matched for pair in pairs]),
            "mild": torch.tensor([False] * mix.strong + [True] * mix.mild),
        }

    def _source(self, rng: np.random.Generator, shares: Mapping[str, float]) -> Source:
        names = [name for name in shares if name in self._found]
        odds = np.array([shares[name] for name in names])
        return self._found[names[rng.choice(len(names), p=odds / odds.sum())]]

    def _clear(self, rng: np.random.Generator) -> "_Single":
        source = self._source(rng, self._mix.clear_shares)
        one = self._cut(rng, source)
        if self._mix.clear_pasted and rng.random() < self._mix.clear_pasted:
            other = self._cut(rng, source)
            taken = self._in_front[other.meanings]
            one.meanings[taken] = other.meanings[taken]
            pixels = np.kron(taken, np.ones((self._mix.clear_stride,) * 2, np.bool_))
            one.image[pixels] = other.image[pixels]
        if self._mix.clear_strong and rng.random() < self._mix.clear_strong:
            return replace(one, image=light.strong(one.image, rng))
        if rng.random() < MILDLY_LIT:
            return replace(one, image=light.mild(one.image, rng))
        return one

    def _cut(self, rng: np.random.Generator, source: Source) -> "_Single":
        shot, _ = source.draw(rng)
        image = training_image(shot.image)
        view, _ = draw_views(image.shape[:2], self._mix.clear_size, FOR_LABELS, rng, self._mix.clear_zoom)
        meanings = self._meanings(shot, image, view, self._mix.clear_size, self._mix.clear_stride)
        folder = self._opinions
        opinions = np.zeros(0, np.float16) if folder is None else opinions_of(folder / opinion_name(shot.image))
        return _Single(view.cut(image, self._mix.clear_size, labels=False), meanings, source.name, view, opinions)

    def _meanings(
        self, shot: Shot, image: Image, view: View, size: tuple[int, int], stride: int = 4
    ) -> npt.NDArray[np.int16]:
        height, width = size
        if shot.labels is None or shot.data_set is None:
            return np.full((height // stride, width // stride), -1, np.int16)
        labels = view.cut(training_labels(shot.labels, image.shape[:2]), size, labels=True)
        return self._tables[shot.data_set][labels[stride // 2 :: stride, stride // 2 :: stride]]

    def _pair(self, rng: np.random.Generator, shares: Mapping[str, float], freedom: Freedom, *, mild: bool) -> "_Pair":
        shots = self._source(rng, shares).draw(rng)
        images = [training_image(shot.image) for shot in shots]
        height, width = self._mix.size
        views = draw_views(images[0].shape[:2], (height, width), freedom, rng)
        cells, positions, matched = shared_cells(*views, (height // STRIDE, width // STRIDE), POINTS, rng)
        ready = []
        for shot, image, view in zip(shots, images, views, strict=True):
            seen = view.cut(image, (height, width), labels=False)
            seen = light.mild(seen, rng) if mild else light.strong(seen, rng)
            ready.append((seen, self._meanings(shot, image, view, (height, width))))
        return _Pair(ready[0], ready[1], shots[0].data_set, cells, positions, matched)


@dataclass(frozen=True)
class _Single:
    image: Image
    meanings: npt.NDArray[np.int16]
    data_set: str
    view: View
    opinions: npt.NDArray[np.float16]


@dataclass(frozen=True)
class _Pair:
    first: tuple[Image, npt.NDArray[np.int16]]
    second: tuple[Image, npt.NDArray[np.int16]]
    data_set: str | None
    cells: npt.NDArray[np.int64]
    positions: npt.NDArray[np.float32]
    matched: bool


def _stacked(images: Sequence[Image]) -> Tensor:
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)


def stream(batches: Batches, start: int, workers: int) -> Iterator[dict[str, Tensor]]:
    """Give the batches from step `start` on, for ever, drawn by `workers` processes (0: by this one)."""
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
    def __init__(self, start: int) -> None:
        self._start = start

    def __iter__(self) -> Iterator[int]:
        step = self._start
        while True:
            yield step
            step += 1

    def __len__(self) -> int:
        return 2**40


def meaning_shares(found: Mapping[str, Source], lexicon: Lexicon) -> npt.NDArray[np.float64]:
    """Count how large a share of all labelled pixels has each meaning, from every fifth picture."""
    counts = np.zeros(len(lexicon.meanings))
    for source in found.values():
        for scene in source.scenes[::5]:
            shot = scene[0]
            if shot.labels is not None and shot.data_set is not None:
                labels = read_labels(shot.labels)[::4, ::4]
                meanings = lexicon.table(shot.data_set)[labels]
                counts += np.bincount(meanings[meanings >= 0], minlength=len(counts))
    shares: npt.NDArray[np.float64] = counts / counts.sum()
    return shares


@functools.lru_cache(maxsize=4096)
def training_image(path: Path) -> Image:
    """Read a picture as RGB, its shorter side at most 450."""
    image = read_rgb(path)
    scale = _SHORT_SIDE / min(image.shape[:2])
    if scale < 0.8:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    return image


@functools.lru_cache(maxsize=4096)
def training_labels(path: Path, shape: tuple[int, int]) -> Image:
    """Read a label map at the size of its picture."""
    labels = read_labels(path)
    if labels.shape != shape:
        labels = np.asarray(cv2.resize(labels, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST), np.uint8)
    return labels


@functools.lru_cache(maxsize=4096)
def opinions_of(path: Path) -> npt.NDArray[np.float16]:
    """Read a teacher's opinions, all 0 where there is no such file."""
    if path.exists():
        return np.asarray(np.load(path), np.float16)
    return np.zeros((len(STREET_WORDS), *OPINION_CELLS), np.float16)


def labels_of(image: Path) -> Path:
    """Find the label map of ``<set>/<split>/images/<name>``."""
    return image.parents[1] / "labels" / f"{image.stem}.png"


def _by_folder(root: Path) -> list[list[Path]]:
    folders: dict[Path, list[Path]] = {}
    for path in sorted(root.rglob("*.jpg")):
        folders.setdefault(path.parent, []).append(path)
    return list(folders.values())


def _one_size(images: Sequence[Path]) -> tuple[int, list[Path]]:
    """Keep the pictures as large as the first: only their pixels correspond. Also give the shorter side."""
    shapes = [read_rgb(path).shape[:2] for path in images]
    return min(shapes[0]), [path for path, shape in zip(images, shapes, strict=True) if shape == shapes[0]]


def _evenly(name: str, scenes: Sequence[Sequence[Shot]]) -> Source:
    return _weighted(name, scenes, [1.0] * len(scenes))


def _weighted(name: str, scenes: Sequence[Sequence[Shot]], weights: Sequence[float]) -> Source:
    total = sum(weights)
    return Source(name, scenes, np.array(weights) / total if total else np.zeros(0))
