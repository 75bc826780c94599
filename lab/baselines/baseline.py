"""What every baseline promises, and how baselines read images."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

from schemas.description import Floats
from schemas.errors import BadImage

UNREADABLE = "undecodable-picture"
"""Code of an image that cannot be decoded."""

Tick = Callable[[], object]
"""Called once for each image that has been described."""


class Baseline(Protocol):
    """A simple way of ranking. To add one: a file with a class like this, and a line in `lab.baselines.known`."""

    @property
    def name(self) -> str:
        """As it stands in tables."""
        ...

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database), small for alike; whatever is learned comes from the database."""
        ...


@runtime_checkable
class Decoding(Protocol):
    """A baseline that reads images by other means than `grey`, which decide what can be decoded."""

    decode: Callable[[Path], object]


def rank_readable(
    baseline: Baseline, database: Sequence[Path], queries: Sequence[Path], tick: Tick
) -> tuple[Floats, int]:
    """Distances as a baseline gives them, infinite for images that cannot be decoded, and how many of these there are.

    Only where it fails on such an image are all of them looked at, and the others ranked again.
    """
    told = 0

    def first() -> None:
        nonlocal told
        told += 1
        tick()

    def again() -> None:
        """Tells only of images that the first ranking did not come to."""
        nonlocal told
        told -= 1
        if told < 0:
            tick()

    with suppress(BadImage):
        return baseline.rank(database, queries, first), 0
    decode = baseline.decode if isinstance(baseline, Decoding) else grey
    kept = [[i for i, path in enumerate(paths) if _readable(path, decode)] for paths in (database, queries)]
    distances = np.full((len(queries), len(database)), np.inf, np.float32)
    if all(kept):
        known, queried = kept
        some = baseline.rank([database[i] for i in known], [queries[i] for i in queried], again)
        distances[np.ix_(queried, known)] = some
    return distances, len(database) + len(queries) - sum(map(len, kept))


def grey(path: Path) -> npt.NDArray[np.uint8]:
    """An image as uint8 (height, width), upright.

    Raises
    ------
    BadImage
        When the file cannot be decoded.
    """
    return _decoded(path, cv2.IMREAD_GRAYSCALE)


def rgb(path: Path) -> npt.NDArray[np.uint8]:
    """An image as uint8 (height, width, 3), RGB, upright; raises as `grey`."""
    return _decoded(path, cv2.IMREAD_COLOR_RGB)


def orb(pixels: npt.NDArray[np.uint8], count: int) -> tuple[Sequence[cv2.KeyPoint], npt.NDArray[np.uint8] | None]:
    """ORB keypoints of a grey image, at most `count`, and their descriptors; none of one that is a pixel wide or high.

    OpenCV fails on an assertion there: a level of the pyramid would have no pixel.
    """
    if min(pixels.shape) < 2:
        return (), None
    keypoints, descriptors = cv2.ORB.create(nfeatures=count).detectAndCompute(pixels, None)
    return keypoints, descriptors


def city_block(database: Floats, queries: Floats) -> Floats:
    """Sums of absolute differences, float32 (queries, database), of descriptors (images, dimensions)."""
    return np.stack([np.abs(database - q).sum(axis=1, dtype=np.float32) for q in queries])


def euclidean(database: Floats, queries: Floats) -> Floats:
    """Euclidean distances, float32 (queries, database), of descriptors (images, dimensions)."""
    squares = (queries**2).sum(axis=1)[:, None] + (database**2).sum(axis=1) - 2 * queries @ database.T
    return np.asarray(np.sqrt(np.maximum(squares, 0)), np.float32)


def described(images: Iterable[Path], describe: Callable[[Path], Floats], tick: Tick) -> Floats:
    """Descriptors of images, float32 (images, dimensions)."""
    rows = []
    for image in images:
        rows.append(describe(image))
        tick()
    return np.stack(rows)


def _readable(path: Path, decode: Callable[[Path], object]) -> bool:
    with suppress(BadImage):
        decode(path)
        return True
    return False


def _decoded(path: Path, how: int) -> npt.NDArray[np.uint8]:
    data = np.fromfile(path, np.uint8)  # cv2.imread crashes where a path is not UTF-8
    pixels = cv2.imdecode(data, how) if data.size else None
    if pixels is None:
        raise BadImage(UNREADABLE, f"{path} cannot be decoded as an image")
    return np.asarray(pixels, np.uint8)
