"""Crops of training images that teachers see once: always the same ones, so that their tokens can be cached.

The shots of an aligned scene (one camera pose) get the same crops, so that a crop by night may be taught by day.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from training.data.images import Pixels
from training.data.sources import LABELLED, images_of

COUNT = 5
"""Crops of each image: the whole of it, and four drawn ones."""

LEAST_SIDE = 150
"""Images with a shorter side than this give only the whole, in pixels."""

_LEAST_SHARE = 0.4
_ASPECT = 0.25


class Crop(NamedTuple):
    """A box in an image, in fractions of its width and height."""

    left: float
    top: float
    width: float
    height: float

    def cut(self, image: Pixels, size: int) -> Pixels:
        """Cut it out of an image, uint8 (height, width, 3), and resize it to `size` x `size`."""
        height, width = image.shape[:2]
        x, y = round(self.left * width), round(self.top * height)
        across, down = max(8, round(self.width * width)), max(8, round(self.height * height))
        part = image[y : y + down, x : x + across]
        how = cv2.INTER_AREA if min(part.shape[:2]) > size else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(part, (size, size), interpolation=how), np.uint8)


WHOLE = Crop(0.0, 0.0, 1.0, 1.0)


def crops_of(image: Path, root: Path, shape: tuple[int, int]) -> list[Crop]:
    """The crops of an image file of `shape` (height, width) pixels below `root`.

    They depend on nothing but the path, or on that of its folder where it belongs to an aligned scene.
    """
    height, width = shape
    if min(shape) < LEAST_SIDE:
        return [WHOLE]
    relative = image.relative_to(root)
    named = relative.parent if "aligned" in relative.parts else relative
    digest = hashlib.sha256(named.as_posix().encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
    drawn = [WHOLE]
    for _ in range(COUNT - 1):
        side = min(shape) * np.exp(rng.uniform(np.log(_LEAST_SHARE), 0.0))
        aspect = np.exp(rng.uniform(-_ASPECT, _ASPECT))
        across, down = min(1.0, side * aspect / width), min(1.0, side / aspect / height)
        left, top = rng.uniform(0, 1 - across), rng.uniform(0, 1 - down)
        drawn.append(Crop(float(left), float(top), float(across), float(down)))
    return drawn


def images_to_distil(data: Path) -> list[Path]:
    """All images below a data folder that a teacher looks at.

    None of ``places`` and of ``pairs/same_place``, by which networks are judged, and none of a labelled test split.
    """
    segmentation = data / "segmentation"
    found: list[Path] = [
        path for name in LABELLED for split in ("train", "val") for path in images_of(segmentation, name, split)
    ]
    for folder in ("pairs/aligned", "unlabelled", "free"):
        found += _photos((data / folder).rglob("*"))
    return found


def token_file(image: Path, root: Path, folder: Path) -> Path:
    """Where the tokens of an image below `root` are cached in `folder`."""
    return folder / f"{hashlib.sha256(image.relative_to(root).as_posix().encode()).hexdigest()[:20]}.npy"


def _photos(paths: Iterable[Path]) -> list[Path]:
    return sorted(path for path in paths if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
