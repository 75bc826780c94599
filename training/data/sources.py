"""What there is to train on below a data folder: labelled images, unlabelled ones, and scenes under several lights."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from training.data.images import Pixels, read_labels, read_rgb
from training.data.lexicon import CITYSCAPES_LABELS, Lexicon, read_classes
from training.data.mix import PSEUDO_LABELLED
from training.data.pseudo_labels import SOFT_LABEL_GRID, Floats16, label_map_name

LABELLED = ("camvid", "labelmefacade", "nyuv2", "ade_outdoor", "drawn")
PHOTOS = "free"
"""A set of photographs outdoors without labels of their own."""

OUTDOOR = ("camvid", "labelmefacade", "ade_outdoor", PHOTOS)
"""What the pretrained trunk, which knows streets, may label."""

CLIP_FILE = Path("text") / "words_ViT-B-16.npz"

_SHORT_SIDE = 360
_LEAST_SIDE = 150


@dataclass(frozen=True)
class Shot:
    """An image file, its label map where it has one, and the data set whose classes the map holds."""

    image: Path
    labels: Path | None = None
    data_set: str | None = None


@dataclass(frozen=True)
class Source:
    """Scenes of one kind. The shots of a scene come from one fixed camera, so that their pixels correspond.

    Attributes
    ----------
    weights : float64 of shape (n_scenes,)
        Probability of each scene; they sum to 1.
    """

    name: str
    scenes: Sequence[Sequence[Shot]]
    weights: npt.NDArray[np.float64]

    def draw(self, rng: np.random.Generator) -> tuple[Shot, Shot]:
        """Draw a scene and two of its shots, the same one twice when it has no other."""
        scene = self.scenes[rng.choice(len(self.scenes), p=self.weights)]
        if len(scene) == 1:
            return scene[0], scene[0]
        first, second = rng.choice(len(scene), 2, replace=False)
        return scene[first], scene[second]


def find_sources(data: Path, pseudo_labels: Path | None, splits: Sequence[str] = ("train",)) -> dict[str, Source]:
    """Find all sources below a data folder.

    Parameters
    ----------
    data : Path
        With the folders ``segmentation``, ``unlabelled`` and ``pairs/aligned``; those that are missing are left out.
    pseudo_labels : Path or None
        Folder of the teacher's label maps of the outdoor images; None leaves that source out.
    splits : sequence of str
        Splits of the labelled sets to learn from.
    """
    found: dict[str, Source] = {}
    for data_set in LABELLED:
        shots = [
            Shot(image, labels_of(image), data_set)
            for split in splits
            for image in images_of(data / "segmentation", data_set, split)
        ]
        found[data_set] = _evenly(data_set, [[shot] for shot in shots])
    photos = images_of(data / "segmentation", PHOTOS, "train")
    found[PHOTOS] = _evenly(PHOTOS, [[Shot(image)] for image in photos])
    if pseudo_labels is not None:
        pseudo = [
            Shot(image, pseudo_labels / label_map_name(image), PSEUDO_LABELLED)
            for data_set in OUTDOOR
            for image in training_images(data / "segmentation", data_set)
        ]
        found[PSEUDO_LABELLED] = _evenly(PSEUDO_LABELLED, [[shot] for shot in pseudo])
    indoor = _by_folder(data / "unlabelled")
    if indoor:
        # A few long walks make up most of these: weigh a folder by the square root of its size.
        walks = [(len(walk), Shot(image)) for walk in indoor for image in walk]
        found["indoor"] = _weighted("indoor", [[shot] for _, shot in walks], [size**-0.5 for size, _ in walks])
    aligned = [_one_size(folder) for folder in _by_folder(data / "pairs" / "aligned")]
    scenes = [(side, [Shot(image) for image in scene]) for side, scene in aligned if len(scene) > 1]
    if scenes:
        weights = [len(scene) ** 0.5 * (1.0 if side > _LEAST_SIDE else 0.15) for side, scene in scenes]
        found["aligned"] = _weighted("aligned", [scene for _, scene in scenes], weights)
    return {name: source for name, source in found.items() if len(source.scenes)}


def find_classes(data: Path) -> dict[str, dict[int, Sequence[str]]]:
    """Give, for every labelled set below a data folder and for the pseudo-labels, label value to text labels."""
    files = {name: data / "segmentation" / name / "classes.json" for name in LABELLED}
    classes = {name: read_classes(path) for name, path in files.items() if path.exists()}
    return classes | {PSEUDO_LABELLED: {value: (label,) for value, label in enumerate(CITYSCAPES_LABELS)}}


def images_of(segmentation: Path, data_set: str, split: str) -> list[Path]:
    """List the images of a labelled set that belong to a split: ``train``, ``val`` or ``test``."""
    return sorted((segmentation / data_set / split / "images").glob("*"))


def training_images(segmentation: Path, data_set: str) -> list[Path]:
    """List the training images of a labelled set."""
    return images_of(segmentation, data_set, "train")


def labels_of(image: Path) -> Path:
    """Find the label map of ``<set>/<split>/images/<name>``."""
    return image.parents[1] / "labels" / f"{image.stem}.png"


def class_shares(sources: Mapping[str, Source], lexicon: Lexicon) -> npt.NDArray[np.float64]:
    """Measure each class's share of all labelled pixels, float64 of shape (n_classes,), from every fifth image."""
    counts = np.zeros(len(lexicon.classes))
    for source in sources.values():
        for scene in source.scenes[::5]:
            shot = scene[0]
            if shot.labels is not None and shot.data_set is not None:
                labels = read_labels(shot.labels)[::4, ::4]
                classes = lexicon.table(shot.data_set)[labels]
                counts += np.bincount(classes[classes >= 0], minlength=len(counts))
    shares: npt.NDArray[np.float64] = counts / counts.sum()
    return shares


@functools.lru_cache(maxsize=4096)
def read_training_image(path: Path) -> Pixels:
    """Read an image as RGB, reduced to a shorter side of 360 where that is 450 or more."""
    image = read_rgb(path)
    scale = _SHORT_SIDE / min(image.shape[:2])
    if scale < 0.8:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    return image


@functools.lru_cache(maxsize=4096)
def read_training_labels(path: Path, shape: tuple[int, int]) -> Pixels:
    """Read a label map at the size of its image, `shape` (height, width)."""
    labels = read_labels(path)
    if labels.shape != shape:
        labels = np.asarray(cv2.resize(labels, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST), np.uint8)
    return labels


@functools.lru_cache(maxsize=4096)
def read_soft_labels(path: Path) -> Floats16:
    """Read soft labels: float16 of shape (19, *SOFT_LABEL_GRID), all 0 where there is no such file."""
    if path.exists():
        return np.asarray(np.load(path), np.float16)
    return np.zeros((len(CITYSCAPES_LABELS), *SOFT_LABEL_GRID), np.float16)


def _by_folder(root: Path) -> list[list[Path]]:
    folders: dict[Path, list[Path]] = {}
    for path in sorted(root.rglob("*.jpg")):
        folders.setdefault(path.parent, []).append(path)
    return list(folders.values())


def _one_size(images: Sequence[Path]) -> tuple[int, list[Path]]:
    """Keep the images as large as the first, since only their pixels correspond; also give the shorter side."""
    shapes = [read_rgb(path).shape[:2] for path in images]
    return min(shapes[0]), [path for path, shape in zip(images, shapes, strict=True) if shape == shapes[0]]


def _evenly(name: str, scenes: Sequence[Sequence[Shot]]) -> Source:
    return _weighted(name, scenes, [1.0] * len(scenes))


def _weighted(name: str, scenes: Sequence[Sequence[Shot]], weights: Sequence[float]) -> Source:
    total = sum(weights)
    return Source(name, scenes, np.array(weights) / total if total else np.zeros(0))
