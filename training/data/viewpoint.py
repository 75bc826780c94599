"""Drawn viewpoints: two overlapping views of one picture, and which of their cells show the same thing.

A `View` is a homography from the view's own coordinates to the source's, both 0..1 from the left and from the top.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Freedom:
    """How much two views of one picture may differ.

    Attributes
    ----------
    ratio
        Greatest ratio of their scales, either way.
    shift
        Greatest distance of their centres, as a share of the first view's sides.
    lean
        Greatest displacement of a corner, as a share of the sides: perspective.
    turn
        Greatest rotation, in degrees.
    """

    ratio: float
    shift: float
    lean: float
    turn: float


ZOOM = (0.5, 1.6)
"""Least and greatest enlargement of a drawn view."""

FOR_WORDS = Freedom(ratio=1.7, shift=0.35, lean=0.08, turn=4.0)
FOR_LABELS = Freedom(ratio=1.0, shift=0.0, lean=0.05, turn=3.0)
FOR_DETAIL = Freedom(ratio=2.2, shift=0.35, lean=0.14, turn=8.0)


@dataclass(frozen=True)
class View:
    """Where a view lies in its source."""

    to_source: Matrix

    def cut(self, image: npt.NDArray[np.uint8], size: tuple[int, int], *, labels: bool) -> npt.NDArray[np.uint8]:
        """Cut the view out of a picture as `size` (height, width).

        Labels are taken from the nearest pixel and are 255, nothing, outside the source; pictures are mirrored there.
        """
        height, width = size
        rows, columns = image.shape[:2]
        matrix = np.diag([columns, rows, 1.0]) @ self.to_source @ np.diag([1 / width, 1 / height, 1.0])
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel centres lie half a pixel in
        matrix = np.linalg.inv(half) @ matrix @ half
        if labels:
            how = {"flags": cv2.INTER_NEAREST, "borderMode": cv2.BORDER_CONSTANT, "borderValue": 255}
        else:
            how = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REFLECT_101}
            shrink = np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
            if shrink > 1.5:
                image = cv2.GaussianBlur(image, (0, 0), 0.4 * shrink)
        how["flags"] |= cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, matrix, (width, height), **how), np.uint8)


def draw_views(
    shape: tuple[int, int],
    size: tuple[int, int],
    freedom: Freedom,
    rng: np.random.Generator,
    zoom: tuple[float, float] = ZOOM,
) -> tuple[View, View]:
    """Draw two overlapping views of `size` from a source of `shape`, both (height, width) in pixels.

    The first is enlarged by `zoom`, least and greatest, for a source 360 pixels high, and more where the source would
    not fill it otherwise.
    """
    first = _box(shape, size, zoom, rng)
    second = _box_near(first, shape, freedom, rng)
    mirrored = rng.random() < 0.5
    return _leaning(first, freedom, rng, mirrored), _leaning(second, freedom, rng, mirrored)


def shared_cells(
    first: View, second: View, cells: tuple[int, int], count: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], Floats, bool]:
    """Draw cells of the first view that the second one shows too.

    Parameters
    ----------
    cells
        Rows and columns of the field of embeddings.

    Returns
    -------
    index : int64 of shape (count,)
        Cells of the first view, row by row.
    position : float32 of shape (count, 2)
        Where the second view shows them: x and y, -1..1 from edge to edge, as ``grid_sample`` wants them.
    enough : bool
        False when the views share fewer than an eighth of `count` cells; the draws are then meaningless.
    """
    rows, columns = cells
    x, y = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    source = _moved(np.column_stack([x.ravel(), y.ravel()]), first.to_source)
    position = _moved(source, np.asarray(np.linalg.inv(second.to_source), np.float64))
    inside = (np.abs(source - 0.5) < 0.5).all(axis=1) & (np.abs(position - 0.5) < 0.48).all(axis=1)
    shared = np.flatnonzero(inside)
    if len(shared) < count // 8:
        return np.zeros(count, np.int64), np.zeros((count, 2), np.float32), False
    index = rng.choice(shared, count, replace=len(shared) < count)
    return index, (position[index] * 2 - 1).astype(np.float32), True


Box = tuple[float, float, float, float]  # centre x, centre y, width, height; all 0..1


def _box(shape: tuple[int, int], size: tuple[int, int], zoom: tuple[float, float], rng: np.random.Generator) -> Box:
    height, width = shape
    # Scale as if the source were 360 high, since sources come in many sizes.
    scale = max(np.exp(rng.uniform(*np.log(zoom))) * 360 / height, size[0] / height, size[1] / width)
    across = min(1.0, size[1] / scale / width * np.exp(rng.uniform(-0.1, 0.1)))
    down = min(1.0, size[0] / scale / height)
    return rng.uniform(across / 2, 1 - across / 2), rng.uniform(down / 2, 1 - down / 2), across, down


def _box_near(box: Box, shape: tuple[int, int], freedom: Freedom, rng: np.random.Generator) -> Box:
    x, y, across, down = box
    limit = np.log(freedom.ratio)
    ratio = np.exp(rng.uniform(-limit, limit))
    ratio = min(ratio, 1 / across, 1 / down)
    wide = min(1.0, across * ratio * np.exp(rng.uniform(-0.1, 0.1)))
    high = down * ratio
    x += rng.uniform(-freedom.shift, freedom.shift) * max(across, wide)
    y += rng.uniform(-freedom.shift, freedom.shift) * 0.7 * max(down, high)
    return float(np.clip(x, wide / 2, 1 - wide / 2)), float(np.clip(y, high / 2, 1 - high / 2)), wide, high


def _leaning(box: Box, freedom: Freedom, rng: np.random.Generator, mirrored: bool) -> View:
    """Turn and lean a box, most of the time, and mirror it when told to."""
    x, y, across, down = box
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    if rng.random() < 0.7:
        corners = corners + rng.uniform(-freedom.lean, freedom.lean, (4, 2))
        angle = np.radians(rng.uniform(-freedom.turn, freedom.turn))
        corners = corners @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    target = (corners * [across, down] + [x, y]).astype(np.float32)
    own = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    if mirrored:
        own[:, 0] = 1 - own[:, 0]
    return View(np.asarray(cv2.getPerspectiveTransform(own, target), np.float64))


def _moved(points: npt.NDArray[Any], matrix: Matrix) -> Matrix:
    moved = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    plane: Matrix = moved[:, :2] / moved[:, 2:]
    return plane
