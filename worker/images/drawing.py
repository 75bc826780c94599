"""Drawings: segmentations, context graphs over the photo, and explanations of a match.

Pixels are uint8 RGB (height, width, 3); positions are (x, y) in fractions of an image's longer side.
"""

import io
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

from schemas.description import Booleans, ContextGraph, Integers
from worker.images.palette import Colour, colour

Pixels = npt.NDArray[np.uint8]
Point = tuple[float, float]

FONT = cv2.FONT_HERSHEY_SIMPLEX
INK: Colour = (24, 26, 30)
PAPER: Colour = (250, 250, 248)
INLIER: Colour = (80, 220, 120)
SHOWN_INLIERS = 80
"""Inliers drawn at most; more would hide the photos."""


def segmentation_png(labels: Integers, size: tuple[int, int], names: Sequence[str]) -> bytes:
    """A label map as an indexed PNG.

    Parameters
    ----------
    labels : integers of shape (rows, columns)
        Index into `names` per cell.
    size : (int, int)
        (width, height) of the image and of the PNG.
    names : sequence of str
        Labels, at most 256; the palette has their colours.

    Returns
    -------
    bytes
        PNG of colour type 3 without transparency: the value of a pixel is the index of its label.
    """
    pil_image = PilImage.fromarray(_stretched(labels, size), mode="P")
    pil_image.putpalette([part for name in names for part in colour(name)])
    buffer = io.BytesIO()
    pil_image.save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()


def overlay_png(pixels: Pixels, labels: Integers, names: Sequence[str], static: Booleans) -> bytes:
    """The photo blended with the colours of its labels, dynamic cells in grey, with a key below.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    labels : integers of shape (rows, columns)
        Index into `names` per cell.
    names : sequence of str
        Labels.
    static : bool of shape (rows, columns)
        False for dynamic cells.
    """
    height, width = pixels.shape[:2]
    wide = _stretched(labels, (width, height))
    still = _stretched(static.astype(np.uint8), (width, height)) > 0
    palette = np.array([colour(name) for name in names], np.uint8)
    blended = (pixels * np.float32(0.55) + palette[wide] * np.float32(0.45)).astype(np.uint8)
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    blended[~still] = (grey[~still] * np.float32(0.35) + 150)[:, None].astype(np.uint8)
    edges = np.zeros((height, width), bool)
    edges[:, 1:] |= wide[:, 1:] != wide[:, :-1]
    edges[1:] |= wide[1:] != wide[:-1]
    blended[edges] = (blended[edges] * np.float32(0.55)).astype(np.uint8)
    return _png(_with_key(blended, labels, names, static))


def graph_png(pixels: Pixels, graph: ContextGraph, names: Sequence[str], tau: float) -> bytes:
    """The photo with its context graph: larger discs for larger regions, edges between nodes at most `tau` apart."""
    image = _toned_down(pixels)
    longer = max(image.shape[:2])
    unit = _unit(image)
    at = [_pixel(position, longer) for position in graph.positions]
    for i in range(len(graph)):
        for j in range(i):
            if np.linalg.norm(graph.positions[i] - graph.positions[j]) <= tau:
                cv2.line(image, at[i], at[j], PAPER, max(1, round(1.2 * unit)), cv2.LINE_AA)
    radii = [max(3 * unit, float(np.sqrt(share)) * 0.11 * longer) for share in graph.shares]
    for i in np.argsort(-graph.shares, kind="stable"):
        radius = round(radii[i])
        cv2.circle(image, at[i], radius, colour(names[graph.labels[i]]), -1, cv2.LINE_AA)
        cv2.circle(image, at[i], radius, PAPER, max(1, round(unit)), cv2.LINE_AA)
    taken: list[tuple[int, int, int, int]] = []
    for i in np.argsort(-graph.shares, kind="stable"):  # large regions first; small ones where there is room
        _name(image, names[graph.labels[i]], (at[i][0], at[i][1] - round(radii[i] + 4 * unit)), unit, taken)
    return _png(image)


def explanation_png(
    query: Pixels,
    view: Pixels,
    inliers: Sequence[tuple[Point, Point]],
    nodes: Sequence[tuple[str, Point, Point]],
    text: Sequence[str],
) -> bytes:
    """Query and view side by side, with lines between inliers and between corresponding nodes.

    Parameters
    ----------
    query, view : uint8 of shape (height, width, 3)
        Of any two sizes.
    inliers : sequence of ((x, y), (x, y))
        Inlier keypoints in query and view; thin green lines.
    nodes : sequence of (label, (x, y), (x, y))
        Corresponding nodes of the context graphs; thick lines in the label's colour, with the label.
    text : sequence of str
        Lines below the images.
    """
    height = 480
    left, right = _at_height(_toned_down(query), height), _at_height(_toned_down(view), height)
    gap, line = 12, 22
    width = left.shape[1] + gap + right.shape[1]
    sheet = np.full((height + 12 + line * len(text) + 6, width, 3), PAPER, np.uint8)
    sheet[:height, : left.shape[1]] = left
    sheet[:height, left.shape[1] + gap :] = right
    shift = left.shape[1] + gap

    def ends(pair: tuple[Point, Point]) -> tuple[tuple[int, int], tuple[int, int]]:
        a, b = _pixel(pair[0], max(left.shape[:2])), _pixel(pair[1], max(right.shape[:2]))
        return a, (b[0] + shift, b[1])

    step = max(1, -(-len(inliers) // SHOWN_INLIERS))
    for pair in inliers[::step]:
        a, b = ends(pair)
        cv2.line(sheet, a, b, INLIER, 1, cv2.LINE_AA)
        for end in (a, b):
            cv2.circle(sheet, end, 3, INLIER, 1, cv2.LINE_AA)
    taken: list[tuple[int, int, int, int]] = []
    for label, *places in nodes:
        a, b = ends((places[0], places[1]))
        cv2.line(sheet, a, b, colour(label), 2, cv2.LINE_AA)
        for end in (a, b):
            cv2.circle(sheet, end, 7, colour(label), -1, cv2.LINE_AA)
            cv2.circle(sheet, end, 7, PAPER, 1, cv2.LINE_AA)
            _name(sheet[:height], label, (end[0], end[1] - 10), 1.0, taken)
    for row, line_text in enumerate(text):
        at = (10, height + 12 + line * row + 14)
        cv2.putText(sheet, line_text, at, FONT, 0.5, INK, 1, cv2.LINE_AA)
    return _png(sheet)


def _stretched(cells: npt.NDArray[Any], size: tuple[int, int]) -> Pixels:
    """Cells enlarged to pixels of an image of (width, height), without interpolation."""
    return np.asarray(cv2.resize(cells.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8)


def _toned_down(pixels: Pixels) -> Pixels:
    """The photo darker and less saturated, so that drawings on it stand out."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)[..., None]
    return np.asarray((pixels * np.float32(0.55) + grey * np.float32(0.25)), np.uint8)


def _unit(image: Pixels) -> float:
    """Scale of drawings: 1 in an image whose longer side is 640 pixels."""
    return int(max(image.shape[:2])) / 640


def _pixel(position: Sequence[float] | npt.NDArray[Any], longer: int) -> tuple[int, int]:
    return round(float(position[0]) * longer), round(float(position[1]) * longer)


def _name(image: Pixels, label: str, at: tuple[int, int], unit: float, taken: list[tuple[int, int, int, int]]) -> None:
    """Write a label centred over a point unless it would cover another; `taken` has the boxes of labels so far."""
    scale, thickness = 0.42 * unit, max(1, round(unit))
    (width, height), _ = cv2.getTextSize(label, FONT, scale, thickness)
    pad = max(2, round(3 * unit))
    x = int(np.clip(at[0] - width // 2, pad, max(pad, image.shape[1] - width - pad)))
    y = int(np.clip(at[1], height + pad, max(height + pad, image.shape[0] - pad)))
    box = (x - pad, y - height - pad, x + width + pad, y + pad)
    if any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
        return
    taken.append(box)
    cv2.rectangle(image, box[:2], box[2:], INK, -1)
    cv2.putText(image, label, (x, y), FONT, scale, _readable(colour(label)), thickness, cv2.LINE_AA)


def _readable(background: Colour) -> Colour:
    """A colour lightened so that it can be read on `INK`."""
    red, green, blue = (round(part + (255 - part) * 0.55) for part in background)
    return red, green, blue


def _with_key(image: Pixels, labels: Integers, names: Sequence[str], static: Booleans) -> Pixels:
    """The image with a key of its labels below, most frequent first."""
    unit = _unit(image)
    line, size = max(12, round(20 * unit)), max(8, round(12 * unit))
    scale, thickness = 0.45 * unit, max(1, round(unit))
    counts = np.bincount(labels.ravel().astype(np.intp), minlength=len(names))
    entries: list[tuple[str, Colour]] = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index]:
            of_label = labels == index
            moves = static[of_label].mean() < 0.5
            name = f"{names[index]} {100 * counts[index] / labels.size:.0f}%" + (" (moves)" if moves else "")
            entries.append((name, (190, 190, 190) if moves else colour(names[index])))
    width = image.shape[1]
    places, x, y = [], line // 3, 0
    for name, _ in entries:
        needed = size + 2 * line // 3 + int(cv2.getTextSize(name, FONT, scale, thickness)[0][0]) + line // 2
        if x + needed > width and x > line // 3:
            x, y = line // 3, y + line
        places.append((x, y))
        x += needed
    key = np.full((y + line + line // 3, width, 3), PAPER, np.uint8)
    for (name, tint), (x, y) in zip(entries, places, strict=True):
        top = y + (line - size) // 2 + line // 6
        cv2.rectangle(key, (x, top), (x + size, top + size), tint, -1)
        cv2.rectangle(key, (x, top), (x + size, top + size), INK, 1)
        cv2.putText(key, name, (x + size + line // 3, top + size), FONT, scale, INK, thickness, cv2.LINE_AA)
    return np.vstack([image, key])


def _at_height(pixels: Pixels, height: int) -> Pixels:
    rows, columns = pixels.shape[:2]
    width = max(1, round(columns * height / rows))
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _png(pixels: Pixels) -> bytes:
    encoded: Pixels = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1]
    return encoded.tobytes()
