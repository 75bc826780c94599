"""Geometric augmentation: overlapping views of one image, related by homographies, and their corresponding cells."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from schemas.description import Floats
from training.data.images import Pixels

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ViewRange:
    """How much two views of one image may differ.

    Attributes
    ----------
    scale : float
        Greatest ratio of their scales, either way.
    shift : float
        Greatest distance of their centres, as a share of the sides of the larger one.
    perspective : float
        Greatest displacement of a corner, as a share of the sides.
    rotation : float
        Greatest rotation, in degrees.
    """

    scale: float
    shift: float
    perspective: float
    rotation: float


ZOOM = (0.5, 1.6)
"""Least and greatest enlargement of a view, for a source 360 pixels high."""

SEMANTIC_RANGE = ViewRange(scale=1.7, shift=0.35, perspective=0.08, rotation=4.0)
LABELLED_RANGE = ViewRange(scale=1.0, shift=0.0, perspective=0.05, rotation=3.0)
DETAIL_RANGE = ViewRange(scale=2.2, shift=0.35, perspective=0.14, rotation=8.0)


@dataclass(frozen=True)
class View:
    """Where a view lies in its source.

    Attributes
    ----------
    to_source : float64 of shape (3, 3)
        Homography from (x, y, 1) in the view to the source, both 0..1 from the left and from the top edge.
    """

    to_source: Matrix

    def cut(self, image: Pixels, size: tuple[int, int], *, labels: bool) -> Pixels:
        """Cut the view out of an image, or out of its label map, as `size` (height, width).

        Images are interpolated bilinearly and mirrored at the edges of the source. Label maps are read at the nearest
        pixel and are 255 (no label) outside the source.
        """
        height, width = size
        rows, columns = image.shape[:2]
        matrix = np.diag([columns, rows, 1.0]) @ self.to_source @ np.diag([1 / width, 1 / height, 1.0])
        half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # pixel centres lie half a pixel in
        matrix = np.linalg.inv(half) @ matrix @ half
        if labels:
            options = {"flags": cv2.INTER_NEAREST, "borderMode": cv2.BORDER_CONSTANT, "borderValue": 255}
        else:
            options = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REFLECT_101}
            shrink = np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
            if shrink > 1.5:
                image = cv2.GaussianBlur(image, (0, 0), 0.4 * shrink)
        options["flags"] |= cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, matrix, (width, height), **options), np.uint8)


def draw_views(
    shape: tuple[int, int],
    size: tuple[int, int],
    view_range: ViewRange,
    rng: np.random.Generator,
    zoom: tuple[float, float] = ZOOM,
) -> tuple[View, View]:
    """Draw two overlapping views of one source.

    Parameters
    ----------
    shape, size : (int, int)
        Height and width of the source and of the views, in pixels.
    view_range : ViewRange
    rng : numpy.random.Generator
    zoom : (float, float)
        Least and greatest enlargement of the first view, for a source 360 pixels high; it is enlarged more where it
        would not lie within the source otherwise.
    """
    first = _box(shape, size, zoom, rng)
    second = _box_near(first, view_range, rng)
    mirrored = rng.random() < 0.5
    return _view(first, view_range, rng, mirrored), _view(second, view_range, rng, mirrored)


def shared_cells(
    first: View, second: View, cells: tuple[int, int], count: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], Floats, bool]:
    """Draw cells of the first view that the second one shows too.

    Parameters
    ----------
    first, second : View
        Of the same source, or of two whose pixels correspond.
    cells : (int, int)
        Rows and columns of a view's field of embeddings.
    count : int
    rng : numpy.random.Generator

    Returns
    -------
    index : int64 of shape (count,)
        Cells of the first view, numbered row by row.
    position : float32 of shape (count, 2)
        Their centres in the second view: x and y, -1..1 from edge to edge, as `torch.nn.functional.grid_sample`
        takes them.
    enough : bool
        False when the views share fewer than an eighth of `count` cells; the other two are then all 0.
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


def _box_near(box: Box, view_range: ViewRange, rng: np.random.Generator) -> Box:
    x, y, across, down = box
    limit = np.log(view_range.scale)
    scale = np.exp(rng.uniform(-limit, limit))
    scale = min(scale, 1 / across, 1 / down)
    wide = min(1.0, across * scale * np.exp(rng.uniform(-0.1, 0.1)))
    high = down * scale
    x += rng.uniform(-view_range.shift, view_range.shift) * max(across, wide)
    y += rng.uniform(-view_range.shift, view_range.shift) * 0.7 * max(down, high)
    return float(np.clip(x, wide / 2, 1 - wide / 2)), float(np.clip(y, high / 2, 1 - high / 2)), wide, high


def _view(box: Box, view_range: ViewRange, rng: np.random.Generator, mirrored: bool) -> View:
    """Give a box perspective and rotation, seven times in ten, and mirror it when told to."""
    x, y, across, down = box
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    if rng.random() < 0.7:
        corners = corners + rng.uniform(-view_range.perspective, view_range.perspective, (4, 2))
        angle = np.radians(rng.uniform(-view_range.rotation, view_range.rotation))
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
