"""The explanation of an answer: the photos with what decided, the parts of the score, and why a rival lost.

Pixels are uint8 RGB (height, width, 3); positions are (x, y) in fractions of an image's longer side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from schemas.description import Doubles
from worker.images import text
from worker.images.drawing import INK, PAPER, SMALLEST_SHARE, Pixels, Point, encode_png, name_nodes
from worker.images.palette import Colour, colour

Corner = tuple[int, int, int]
"""(x, y) of a photo's upper left pixel, and its longer side in pixels."""

WIDTH = 1600
"""Width of the sheet in pixels."""

MARGIN, GAP = 28, 36
PHOTO_HEIGHT = 480
"""Largest height of a photo on the sheet."""

FOR_MATCH: Colour = (38, 166, 91)
FOR_RIVAL: Colour = (232, 119, 34)
INLIER: Colour = (64, 190, 255)
FAINT: Colour = (110, 114, 120)
TRACK: Colour = (228, 229, 230)
STATUS: dict[str, tuple[str, Colour]] = {
    "matched": ("MATCHED", FOR_MATCH),
    "ambiguous": ("AMBIGUOUS", (214, 150, 10)),
    "no_match": ("NO MATCH", (178, 58, 58)),
}
SHOWN_INLIERS = 30
"""Inliers drawn at most, evenly chosen; more would hide the photos."""


@dataclass(frozen=True)
class Headline:
    """The verdict on an answer in words.

    Parameters
    ----------
    status : str
        ``matched``, ``ambiguous`` or ``no_match``.
    probability : float
        That the first view shows the place, 0..1.
    reason : str
    """

    status: str
    probability: float
    reason: str


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo of an explanation.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    title, caption : str
        Written above and below it.
    cells : float64 of shape (rows, columns), or None
        Weight of each cell that agrees, as a share of the largest weight of all cells together; 0 for the others.
    """

    pixels: Pixels
    title: str
    caption: str
    cells: Doubles | None = None


@dataclass(frozen=True)
class Part:
    """One part of the score: of the match, and of the rival where there is one."""

    name: str
    match: float
    rival: float | None = None


@dataclass(frozen=True, eq=False)
class Sheet:
    """All that an explanation shows.

    Parameters
    ----------
    headline : Headline
    query, match : Photo
    rival : Photo or None
        The other view that the match is compared with.
    parts : sequence of Part
        The last is the score itself.
    notes : sequence of str
        What decided, in words.
    verdict : str
        Why the rival lost or won; empty without a rival.
    inliers : sequence of (point, point)
        Keypoints in the query and in the match.
    nodes : sequence of (label, point, point)
        Corresponding regions in the query and in the match.
    speaks : int8 of shape (rows, columns), or None
        1 for cells of the query that speak for the match, -1 for those that speak for the rival, 0 elsewhere.
    """

    headline: Headline
    query: Photo
    match: Photo
    rival: Photo | None
    parts: Sequence[Part]
    notes: Sequence[str] = ()
    verdict: str = ""
    inliers: Sequence[tuple[Point, Point]] = ()
    nodes: Sequence[tuple[str, Point, Point]] = ()
    speaks: npt.NDArray[np.int8] | None = None


def explanation_png(sheet: Sheet) -> bytes:
    """The sheet as PNG, `WIDTH` pixels wide; its height follows from what it shows."""
    bands = [_header(sheet.headline), _photos(sheet), _decided(sheet), _key(sheet)]
    return encode_png(np.vstack(bands))


def _blank(height: int, width: int = WIDTH) -> Pixels:
    return np.full((height, width, 3), PAPER, np.uint8)


def _header(headline: Headline) -> Pixels:
    """The verdict, the probability and the reason."""
    name, tint = STATUS.get(headline.status, (headline.status.replace("_", " ").upper(), FAINT))
    name = text.fitted(name, 22, 400)
    lines = text.wrapped(headline.reason, 18, WIDTH - 2 * MARGIN, 2)
    band = _blank(76 + 24 * len(lines))
    right = MARGIN + text.width(name, 22) + 28
    cv2.rectangle(band, (MARGIN, 22), (right, 58), tint, -1)
    text.write(band, name, (MARGIN + 14, 48), 22, PAPER)
    sure = f"probability {headline.probability:.2f} that the first match shows this place"
    text.write(band, text.fitted(sure, 22, WIDTH - MARGIN - right - 18), (right + 18, 48), 22, INK)
    for row, line in enumerate(lines):
        text.write(band, line, (MARGIN, 84 + 24 * row), 18, INK)
    return band


def _photos(sheet: Sheet) -> Pixels:
    """The photos in a row, titled, with the lines between query and match."""
    photos = [photo for photo in (sheet.query, sheet.match, sheet.rival) if photo is not None]
    room = (WIDTH - 2 * MARGIN - GAP * (len(photos) - 1)) // len(photos)
    above, below = 40, 34
    sizes = [_within(photo.pixels, room, PHOTO_HEIGHT) for photo in photos]
    highest = max(height for _, height in sizes)
    band = _blank(above + highest + below)
    tints = (FOR_MATCH, FOR_MATCH, FOR_RIVAL)
    corners, columns = [], []
    for number, (photo, size, tint) in enumerate(zip(photos, sizes, tints, strict=False)):
        left = MARGIN + number * (room + GAP)
        x = left + (room - size[0]) // 2
        smaller = size[0] < photo.pixels.shape[1]
        resized = cv2.resize(photo.pixels, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR)
        drawn = _with_cells(np.asarray(resized, np.uint8), photo.cells, tint)
        if number == 0 and sheet.speaks is not None:
            _outline(drawn, sheet.speaks == 1, FOR_MATCH)
            _outline(drawn, sheet.speaks == -1, FOR_RIVAL)
        band[above : above + size[1], x : x + size[0]] = drawn
        text.write(band, text.fitted(photo.title, 18, room), (left, above - 12), 18, INK)
        if number:
            cv2.rectangle(band, (x - 3, above - 3), (x + size[0] + 2, above + size[1] + 2), tint, 2)
        text.write(band, text.fitted(photo.caption, 15, room), (left, above + highest + 24), 15, FAINT)
        corners.append((x, above, max(size)))
        columns.append(slice(left, left + room))
    _join(band, sheet, corners[0], corners[1])
    for number, (corner, column) in enumerate(zip(corners[:2], columns[:2], strict=True)):
        ends = [(label, _at((one, other)[number], corner)) for label, one, other in sheet.nodes]
        # In the photo's own column, so that a name neither leaves the sheet nor reaches the next photo.
        named = [(label, (x - column.start, y - above - 14)) for label, (x, y) in ends]
        name_nodes(band[above : above + highest, column], named, 13)
    return band


def _within(pixels: Pixels, width: int, height: int) -> tuple[int, int]:
    """(width, height) of an image scaled to fit."""
    scale = min(width / pixels.shape[1], height / pixels.shape[0])
    return max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale))


def _with_cells(pixels: Pixels, cells: Doubles | None, tint: Colour) -> Pixels:
    """The photo as it is and tinted where cells agree, the more the heavier they are; grey and dark elsewhere.

    The tint is full where a cell has as much weight as in a perfect match, in which all cells weigh the same.
    """
    if cells is None:
        return pixels.copy()
    strength = np.sqrt(np.clip(cells * cells.size, 0, 1)).astype(np.float32)
    size = (pixels.shape[1], pixels.shape[0])
    cover = cv2.resize(np.where(strength > 0, 0.2 + 0.35 * strength, 0), size, interpolation=cv2.INTER_NEAREST)[
        ..., None
    ]
    lit = pixels * (1 - cover) + np.array(tint, np.float32) * cover
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)[..., None] * np.float32(0.6) + 20
    drawn: Pixels = np.where(cover > 0, lit, grey).astype(np.uint8)
    return drawn


def _outline(pixels: Pixels, cells: npt.NDArray[np.bool_], tint: Colour) -> None:
    """Outline regions of cells."""
    size = (pixels.shape[1], pixels.shape[0])
    mask = cv2.resize(cells.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(pixels, outlines, -1, PAPER, 4)
    cv2.drawContours(pixels, outlines, -1, tint, 2)


def _at(point: Point, corner: Corner) -> tuple[int, int]:
    """Pixel of the band at a position in a photo."""
    x, y, longer = corner
    return x + round(point[0] * longer), y + round(point[1] * longer)


def _join(band: Pixels, sheet: Sheet, query: Corner, match: Corner) -> None:
    """Lines between inliers and between corresponding nodes."""
    step = max(1, -(-len(sheet.inliers) // SHOWN_INLIERS))
    lines = band.copy()
    for one, other in sheet.inliers[::step]:
        cv2.line(lines, _at(one, query), _at(other, match), INLIER, 1, cv2.LINE_AA)
    for label, one, other in sheet.nodes:
        cv2.line(lines, _at(one, query), _at(other, match), PAPER, 5, cv2.LINE_AA)
        cv2.line(lines, _at(one, query), _at(other, match), colour(label), 3, cv2.LINE_AA)
    cv2.addWeighted(lines, 0.6, band, 0.4, 0, dst=band)
    for one, other in sheet.inliers[::step]:
        for end in (_at(one, query), _at(other, match)):
            cv2.circle(band, end, 3, INLIER, -1, cv2.LINE_AA)
            cv2.circle(band, end, 3, INK, 1, cv2.LINE_AA)
    ends = [(label, _at(one, query), _at(other, match)) for label, one, other in sheet.nodes]
    for label, *both in ends:
        for end in both:
            cv2.circle(band, end, 9, colour(label), -1, cv2.LINE_AA)
            cv2.circle(band, end, 9, PAPER, 2, cv2.LINE_AA)


def _decided(sheet: Sheet) -> Pixels:
    """The parts of the score as bars on the left, what decided in words on the right."""
    column = (WIDTH - 2 * MARGIN - GAP) // 2
    left, right = _bars(sheet, column), _words(sheet, column)
    band = _blank(max(len(left), len(right)))
    band[: len(left), MARGIN : MARGIN + column] = left
    band[: len(right), WIDTH - MARGIN - column : WIDTH - MARGIN] = right
    return band


def _bars(sheet: Sheet, width: int) -> Pixels:
    """Bars of all parts, on one scale from 0 to 1."""
    parts = sheet.parts
    row = 40 if any(part.rival is not None for part in parts) else 26
    panel = _blank(44 + row * len(parts) + 8, width)
    text.write(panel, "parts of the score", (0, 28), 17, INK)
    x = text.width("parts of the score", 17) + 24
    for photo, tint in ((sheet.match, FOR_MATCH), (sheet.rival, FOR_RIVAL)):
        if photo is not None:
            name = text.fitted(photo.title, 15, (width - x) // (2 if photo is sheet.match and sheet.rival else 1) - 26)
            cv2.rectangle(panel, (x, 16), (x + 12, 28), tint, -1)
            text.write(panel, name, (x + 18, 28), 15, FAINT)
            x += 18 + text.width(name, 15) + 20
    names = [text.fitted(part.name, 15, 190) for part in parts]
    start = text.widest(names, 15) + 16
    room = width - start - 70
    for number, (part, name) in enumerate(zip(parts, names, strict=True)):
        top = 40 + row * number
        if number == len(parts) - 1:
            cv2.line(panel, (0, top), (width, top), TRACK, 1)
        text.write(panel, name, (0, top + row // 2 + 5), 15, INK)
        values = [(part.match, FOR_MATCH)] + ([] if part.rival is None else [(part.rival, FOR_RIVAL)])
        for line, (value, tint) in enumerate(values):
            y = top + row // 2 - 8 * len(values) + 16 * line + 1
            cv2.rectangle(panel, (start, y), (start + room, y + 12), TRACK, -1)
            cv2.rectangle(panel, (start, y), (start + max(1, round(room * min(max(value, 0), 1))), y + 12), tint, -1)
            text.write(panel, f"{value:.3f}", (start + room + 10, y + 12), 15, INK)
    return panel


def _words(sheet: Sheet, width: int) -> Pixels:
    """What decided, and why the rival lost or won."""
    lines = [(line, INK, bullet) for note in sheet.notes for line, bullet in _bulleted(note, width)]
    verdict = [(line, INK, False) for line in text.wrapped(sheet.verdict, 16, width - 16, 4)]
    panel = _blank(44 + 22 * len(lines) + (22 * len(verdict) + 24 if verdict else 0) + 8, width)
    text.write(panel, "what decided", (0, 28), 17, INK)
    y = 52
    for line, tint, bullet in lines:
        if bullet:
            cv2.circle(panel, (4, y - 5), 3, FAINT, -1, cv2.LINE_AA)
        text.write(panel, line, (16, y), 16, tint)
        y += 22
    if verdict:
        cv2.rectangle(panel, (0, y - 6), (4, y + 22 * len(verdict) + 2), FOR_RIVAL, -1)
        for row, (line, tint, _) in enumerate(verdict):
            text.write(panel, line, (16, y + 12 + 22 * row), 16, tint)
    return panel


def _bulleted(note: str, width: int) -> list[tuple[str, bool]]:
    return [(line, number == 0) for number, line in enumerate(text.wrapped(note, 16, width - 16, 3))]


def _key(sheet: Sheet) -> Pixels:
    """What the marks mean; only those that are drawn."""
    entries = _drawn_marks(sheet)
    places, x, y = [], MARGIN, 0
    for _, name, _ in entries:
        needed = 34 + text.width(name, 14) + 26
        if x + needed > WIDTH - MARGIN and x > MARGIN:
            x, y = MARGIN, y + 24
        places.append((x, y))
        x += needed
    band = _blank(y + 44 if entries else 12)
    for (mark, name, tint), (x, y) in zip(entries, places, strict=True):
        _draw_mark(band, mark, (x, y + 10), tint)
        text.write(band, name, (x + 34, y + 22), 14, FAINT)
    return band


def _drawn_marks(sheet: Sheet) -> list[tuple[str, str, Colour]]:
    """The marks of a sheet: kind, meaning and colour of each."""
    entries: list[tuple[str, str, Colour]] = []
    if sheet.match.cells is not None:
        entries.append(("cell", "cells that agree with the match; stronger tint: more weight", FOR_MATCH))
    if sheet.rival is not None and sheet.rival.cells is not None:
        entries.append(("cell", "with the other view", FOR_RIVAL))
    if sheet.speaks is not None and (sheet.speaks == 1).any():
        entries.append(("outline", "speaks for the match", FOR_MATCH))
    if sheet.speaks is not None and (sheet.speaks == -1).any():
        entries.append(("outline", "speaks for the other view", FOR_RIVAL))
    if sheet.inliers:
        entries.append(("line", "keypoint that fits the geometry", INLIER))
    if sheet.nodes:
        share = f"region of the context graph, at least {100 * SMALLEST_SHARE:.0f} % of the image"
        entries.append(("disc", share, FAINT))
    return entries


def _draw_mark(band: Pixels, mark: str, corner: tuple[int, int], tint: Colour) -> None:
    """Draw a mark of 24 x 14 pixels; `corner` is its upper left one."""
    x, y = corner
    if mark == "cell":
        cv2.rectangle(band, corner, (x + 24, y + 14), tint, -1)
    elif mark == "outline":
        cv2.rectangle(band, corner, (x + 24, y + 14), tint, 2)
    elif mark == "line":
        cv2.line(band, (x, y + 7), (x + 24, y + 7), tint, 2, cv2.LINE_AA)
    else:
        cv2.circle(band, (x + 12, y + 7), 8, tint, -1, cv2.LINE_AA)
