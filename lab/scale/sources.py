"""Images that fill a map: those of the sets, distractors, and their mirror images, crops and drawn scenes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from lab.datasets.dataset import ENDINGS
from scenes import Scene
from scenes.scene import Kind
from schemas.image import Image
from worker.images.codec import SHORTEST_SIDE

CROP = 0.72
"""Side of a crop, as a fraction of the image's."""

DRAWN_SIZE = (448, 336)
"""Width and height of drawn scenes, pixels."""

Decode = Callable[[bytes], Image]


@dataclass(frozen=True)
class Source:
    """One image of the pool.

    Parameters
    ----------
    key : str
        Names its description in the cache.
    site : str
        Images of one site are no distractors for its sets.
    read : function
        From a decoder of files to the image.
    """

    key: str
    site: str
    read: Callable[[Decode], Image]


def site_of(path: Path, root: Path) -> str:
    """The site of a file: the folders that show one place at several times count as one.

    Parameters
    ----------
    path, root : Path
        The file, and the folder that holds ``places``, ``unlabelled`` and the like.
    """
    parts = path.relative_to(root).parts
    name = parts[1] if parts[0] == "places" else "/".join(parts[:3])
    return SAME_SITE.get(name, name)


SAME_SITE = {
    "pepper_changed": "pepper_repeat",
    "unlabelled/indoor/multifloor_office": "floors",
}
"""Folders that may show the building of another one."""


def originals(root: Path) -> list[Source]:
    """All images below a folder, those of ``places`` first, the rest in a fixed random order.

    Files named as labels (PNG beside JPEG in ``segmentation``) are left out.
    """
    paths = sorted(p for p in root.rglob("*") if p.suffix.lower() in ENDINGS - {".png"})
    first = [p for p in paths if p.relative_to(root).parts[0] == "places"]
    rest = [p for p in paths if p.relative_to(root).parts[0] != "places"]
    order = np.random.default_rng(0).permutation(len(rest))
    return [Source(str(p.relative_to(root)), site_of(p, root), _reader(p)) for p in [*first, *(rest[i] for i in order)]]


def varied(sources: Sequence[Source]) -> Iterator[Source]:
    """The mirror images of all, then crops of all, each in a fixed random order."""
    order = np.random.default_rng(1).permutation(len(sources))
    for name, change in (("mirror", _mirrored), ("crop", _cropped)):
        for i in order:
            source = sources[i]
            yield replace(source, key=f"{source.key}#{name}", read=_changed(source, change))


def drawn(count: int) -> Iterator[Source]:
    """Drawn scenes, each of a place of its own."""
    kinds: list[Kind] = sorted(get_args(Kind))
    for number in range(count):
        kind = kinds[number % len(kinds)]
        yield Source(f"drawn/{kind}/{number}", "drawn", _drawing(kind, number))


def _reader(path: Path) -> Callable[[Decode], Image]:
    return lambda decode: decode(path.read_bytes())


def _changed(source: Source, change: Callable[[Image], Image]) -> Callable[[Decode], Image]:
    return lambda decode: change(source.read(decode))


def _mirrored(image: Image) -> Image:
    return Image.of(image.pixels[:, ::-1])


def _cropped(image: Image) -> Image:
    """A crop at the corner that the image's digest decides."""
    height, width = image.pixels.shape[:2]
    rows, columns = max(SHORTEST_SIDE, round(height * CROP)), max(SHORTEST_SIDE, round(width * CROP))
    corner = int(image.digest[:2], 16)
    down, across = (height - rows) * (corner & 1), (width - columns) * (corner >> 1 & 1)
    return Image.of(image.pixels[down : down + rows, across : across + columns])


def _drawing(kind: Kind, number: int) -> Callable[[Decode], Image]:
    return lambda _: Image.of(Scene(number, kind).sized(*DRAWN_SIZE).pixels)
