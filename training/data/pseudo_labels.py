"""Files of what a teacher network answers for training images, made once before a run.

Label maps hold the teacher's class where it is confident. Soft labels hold its probabilities of all classes on a coarse
grid: the targets of knowledge distillation (`training.losses.distillation`).
"""

import io
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from training.data.images import Pixels, read_rgb

SOFT_LABEL_GRID = (40, 40)
"""Rows and columns of soft labels, whatever the shape of the image: about the resolution of the teacher's output."""

Floats16 = npt.NDArray[np.float16]


def write_label_maps(label_map: Callable[[Pixels], Pixels], images: Iterable[Path], folder: Path) -> None:
    """Write a label map of each image as ``<folder>/<set>__<name>.png``; files that exist are kept."""
    _write_each(images, folder, label_map_name, lambda image: cv2.imencode(".png", label_map(image))[1].tobytes())


def write_soft_labels(soft_labels: Callable[[Pixels], Floats16], images: Iterable[Path], folder: Path) -> None:
    """Write soft labels of each image as ``<folder>/<set>__<name>.npy``; files that exist are kept."""

    def content(image: Pixels) -> bytes:
        file = io.BytesIO()
        np.save(file, soft_labels(image))
        return file.getvalue()

    _write_each(images, folder, soft_labels_name, content)


def label_map_name(image: Path) -> str:
    """Name the label map of ``<set>/<split>/images/<name>``."""
    return f"{image.parents[2].name}__{image.stem}.png"


def soft_labels_name(image: Path) -> str:
    """Name the file of soft labels of ``<set>/<split>/images/<name>``."""
    return f"{image.parents[2].name}__{image.stem}.npy"


def _write_each(
    images: Iterable[Path], folder: Path, name: Callable[[Path], str], content: Callable[[Pixels], bytes]
) -> None:
    """Write a file for each image, whole or not at all, so that a run that was killed can go on with what is there."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in images:
        target = folder / name(path)
        if not target.exists():
            partial = target.with_suffix(".partial")
            partial.write_bytes(content(read_rgb(path)))
            partial.replace(target)
