"""Drawings over a photo: its segmentation and its context graph, each as large as the photo.

Pixels are uint8 RGB (height, width, 3); positions are (x, y) in fractions of an image's longer side.
"""

import io
from collections.abc import Collection, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

from schemas.description import Booleans, ContextGraph, Integers
from worker.images import text
from worker.images.palette import Colour, colour

Pixels = npt.NDArray[np.uint8]
Point = tuple[float, float]

INK: Colour = (24, 26, 30)
PAPER: Colour = (250, 250, 248)
MOVING: Colour = (190, 190, 190)

SMALLEST_SHARE = 0.01
"""Regions of a smaller share of the image are left out: they are specks, and would hide the photo."""

UNIT = 640
"""Longer side, in pixels, of the image for which sizes of fonts, lines and discs are given."""

STRIP = 4
"""Of an image that is more than so many times as long as wide, the shorter side says how large these are."""

ROWS_AT_ONCE = 64
"""Of a photo that are blended together: as floats, one of 50 megapixels would take 600 MB."""

ROUNDING = 1e-6
"""Shares are float32: one that was rounded just below the smallest is drawn."""


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


def overlay_png(
    pixels: Pixels, labels: Integers, names: Sequence[str], static: Booleans, *, legend: bool = False, caption: str = ""
) -> bytes:
    """The photo blended with the colours of its labels, dynamic cells in grey.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    labels : integers of shape (rows, columns)
        Index into `names` per cell.
    names : sequence of str
        Labels.
    static : bool of shape (rows, columns)
        False for dynamic cells.
    legend : bool
        Whether to add a key of the labels below the photo, most frequent first.
    caption : str
        Written below the key.
    """
    height, width = pixels.shape[:2]
    wide = _stretched(labels, (width, height))
    still = _stretched(static.astype(np.uint8), (width, height)) > 0
    palette = np.array([colour(name) for name in names], np.uint8)
    blended = np.empty_like(pixels)
    for at in range(0, height, ROWS_AT_ONCE):
        rows = slice(at, at + ROWS_AT_ONCE)
        above = wide[max(at - 1, 0)][None]
        blended[rows] = _blended(
            pixels[rows], wide[rows], np.concatenate([above, wide[rows][:-1]]), still[rows], palette
        )
    return encode_png(_with_key(blended, _frequent(labels, names, static), caption) if legend else blended)


def _blended(pixels: Pixels, labels: Pixels, above: Pixels, still: Booleans, palette: Pixels) -> Pixels:
    """Rows of a photo blended with the colours of labels; `above` are the labels of the row above each."""
    blended = (pixels * np.float32(0.55) + palette[labels] * np.float32(0.45)).astype(np.uint8)
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    blended[~still] = (grey[~still] * np.float32(0.35) + 150)[:, None].astype(np.uint8)
    edges = labels != above
    edges[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    blended[edges] = (blended[edges] * np.float32(0.55)).astype(np.uint8)
    return np.asarray(blended, np.uint8)


def graph_png(
    pixels: Pixels,
    graph: ContextGraph,
    names: Sequence[str],
    tau: float,
    *,
    dynamic: Collection[str] = (),
    legend: bool = False,
    caption: str = "",
) -> bytes:
    """The photo with its context graph: larger discs for larger regions, edges between nodes at most `tau` apart.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    graph : ContextGraph
    names : sequence of str
        Labels.
    tau : float
        Longest edge, as a fraction of the longer side.
    dynamic : collection of str
        Labels of things that move. Their nodes are left out, as are those of regions below `SMALLEST_SHARE`.
    legend : bool
        Whether to add a key of the labels below the photo, most nodes first.
    caption : str
        Written below the key.
    """
    image = toned_down(pixels)
    longer, size = max(image.shape[:2]), _size(image)
    unit = size / UNIT
    drawn = [i for i in np.argsort(-graph.shares, kind="stable") if is_drawn(graph, int(i), names, dynamic)]
    at = {i: _pixel(graph.positions[i], longer) for i in drawn}
    for number, i in enumerate(drawn):
        for j in drawn[:number]:
            if np.linalg.norm(graph.positions[i] - graph.positions[j]) <= tau:
                cv2.line(image, at[i], at[j], PAPER, max(1, round(1.2 * unit)), cv2.LINE_AA)
    radii = {i: max(3 * unit, float(np.sqrt(graph.shares[i])) * 0.11 * size) for i in drawn}
    for i in drawn:
        cv2.circle(image, at[i], round(radii[i]), colour(names[graph.labels[i]]), -1, cv2.LINE_AA)
        cv2.circle(image, at[i], round(radii[i]), PAPER, max(1, round(unit)), cv2.LINE_AA)
    # Large regions first; small ones where there is room.
    above = [(names[graph.labels[i]], (at[i][0], at[i][1] - round(radii[i] + 4 * unit))) for i in drawn]
    name_nodes(image, above, max(9, round(13 * unit)))
    if not legend:
        return encode_png(image)
    counts = np.bincount(graph.labels[drawn].astype(np.intp), minlength=len(names))
    entries = [(f"{names[i]} {counts[i]}", colour(names[i])) for i in np.argsort(-counts, kind="stable") if counts[i]]
    return encode_png(_with_key(image, entries, caption))


def is_drawn(graph: ContextGraph, node: int, names: Sequence[str], dynamic: Collection[str]) -> bool:
    """Whether a node of a graph is drawn: its label does not move, and its region is large enough to be seen."""
    return names[graph.labels[node]] not in dynamic and float(graph.shares[node]) >= SMALLEST_SHARE - ROUNDING


def name_nodes(image: Pixels, names: Sequence[tuple[str, tuple[int, int]]], size: int) -> None:
    """Write names centred over their points (x, y), but none that would cover an earlier one; `size` is the font's."""
    pad = max(2, size // 4)
    taken: list[tuple[int, int, int, int]] = []
    for name, (over, bottom) in names:
        label = text.fitted(name, size, image.shape[1] - 2 * pad)
        if not label:
            continue
        width = text.width(label, size)
        x = int(np.clip(over - width // 2, pad, max(pad, image.shape[1] - width - pad)))
        y = int(np.clip(bottom, size + pad, max(size + pad, image.shape[0] - pad)))
        box = (x - pad, y - size - pad // 2, x + width + pad, y + size // 4 + pad // 2)
        if any(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in taken):
            continue
        taken.append(box)
        cv2.rectangle(image, box[:2], box[2:], INK, -1)
        text.write(image, label, (x, y), size, _readable(colour(name)))


def toned_down(pixels: Pixels) -> Pixels:
    """The photo darker and less saturated, so that drawings on it stand out."""
    toned = np.empty_like(pixels)
    for at in range(0, len(pixels), ROWS_AT_ONCE):
        part = pixels[at : at + ROWS_AT_ONCE]
        grey = cv2.cvtColor(part, cv2.COLOR_RGB2GRAY)[..., None]
        toned[at : at + ROWS_AT_ONCE] = part * np.float32(0.55) + grey * np.float32(0.25)
    return toned


def encode_png(pixels: Pixels) -> bytes:
    """RGB pixels as PNG."""
    encoded: Pixels = cv2.imencode(".png", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))[1]
    return encoded.tobytes()


def _stretched(cells: npt.NDArray[Any], size: tuple[int, int]) -> Pixels:
    """Cells enlarged to pixels of an image of (width, height), without interpolation."""
    return np.asarray(cv2.resize(cells.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8)


def _size(image: Pixels) -> int:
    """Pixels by which drawings are scaled: the longer side, unless what is drawn would not fit into the shorter one."""
    shorter, longer = sorted(image.shape[:2])
    return int(min(longer, STRIP * shorter))


def _pixel(position: Sequence[float] | npt.NDArray[Any], longer: int) -> tuple[int, int]:
    return round(float(position[0]) * longer), round(float(position[1]) * longer)


def _readable(background: Colour) -> Colour:
    """A colour lightened so that it can be read on `INK`."""
    red, green, blue = (round(part + (255 - part) * 0.55) for part in background)
    return red, green, blue


def _frequent(labels: Integers, names: Sequence[str], static: Booleans) -> list[tuple[str, Colour]]:
    """Entries of a key: labels with at least `SMALLEST_SHARE` of the cells, most frequent first."""
    counts = np.bincount(labels.ravel().astype(np.intp), minlength=len(names))
    entries: list[tuple[str, Colour]] = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index] >= SMALLEST_SHARE * labels.size:
            moves = static[labels == index].mean() < 0.5
            name = f"{names[index]} {100 * counts[index] / labels.size:.0f}%" + (" (moves)" if moves else "")
            entries.append((name, MOVING if moves else colour(names[index])))
    return entries


def _with_key(image: Pixels, entries: Sequence[tuple[str, Colour]], caption: str) -> Pixels:
    """The image with a key below, and a caption below that."""
    unit = _size(image) / UNIT
    line, box = max(14, round(20 * unit)), max(8, round(12 * unit))
    size = max(10, round(14 * unit))
    width = image.shape[1]
    names = [text.fitted(name, size, width - box - line) for name, _ in entries]
    places, x, y = [], line // 3, 0
    for name in names:
        needed = box + line // 3 + text.width(name, size) + line // 2
        if x + needed > width and x > line // 3:
            x, y = line // 3, y + line
        places.append((x, y))
        x += needed
    lines = text.wrapped(caption, size, width - 2 * (line // 3), 3)
    below = y + line if entries else 0
    key = np.full((below + line * len(lines) + line // 3, width, 3), PAPER, np.uint8)
    for name, (_, tint), (x, y) in zip(names, entries, places, strict=True):
        top = y + (line - box) // 2 + line // 6
        cv2.rectangle(key, (x, top), (x + box, top + box), tint, -1)
        cv2.rectangle(key, (x, top), (x + box, top + box), INK, 1)
        text.write(key, name, (x + box + line // 3, top + box), size, INK)
    for number, caption_line in enumerate(lines):
        text.write(key, caption_line, (line // 3, below + line * number + round(line * 0.8)), size, INK)
    return np.vstack([image, key])
