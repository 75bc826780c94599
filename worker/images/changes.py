"""The drawing of what changed: the earlier photo beside the later one, each thing outlined where it is seen.

Pixels are uint8 RGB (height, width, 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from schemas.description import Booleans
from worker.images import text
from worker.images.drawing import INK, PAPER, Pixels, encode_png, name_nodes
from worker.images.palette import Colour

WIDTH, MARGIN, GAP = 1280, 24, 24
PHOTO_HEIGHT = 640
"""Largest height of a photo."""

FAINT: Colour = (110, 114, 120)
TINTS: dict[str, Colour] = {"gone": (214, 70, 60), "new": (38, 166, 91), "moved": (235, 150, 20)}
KINDS = {"gone": "gone since", "new": "new", "moved": "moved"}


@dataclass(frozen=True, eq=False)
class Mark:
    """One outlined thing: how it changed, what is written at it, and its cells, bool (rows, columns)."""

    kind: Literal["gone", "new", "moved"]
    name: str
    cells: Booleans


@dataclass(frozen=True, eq=False)
class Side:
    """One photo, its title, and what is outlined in it."""

    pixels: Pixels
    title: str
    marks: Sequence[Mark] = ()


def changes_png(then: Side, now: Side, summary: str) -> bytes:
    """Both photos side by side as PNG, `WIDTH` pixels wide; `summary` is written below them."""
    room = (WIDTH - 2 * MARGIN - GAP) // 2
    panels = [_panel(side, room) for side in (then, now)]
    above, highest = 44, max(panel.shape[0] for panel in panels)
    lines = text.wrapped(summary, 16, WIDTH - 2 * MARGIN, 3)
    sheet = np.full((above + highest + 44 + 22 * len(lines) + 12, WIDTH, 3), PAPER, np.uint8)
    for number, (side, panel) in enumerate(zip((then, now), panels, strict=True)):
        left = MARGIN + number * (room + GAP)
        text.write(sheet, text.fitted(side.title, 18, room), (left, above - 14), 18, INK)
        x = left + (room - panel.shape[1]) // 2
        sheet[above : above + panel.shape[0], x : x + panel.shape[1]] = panel
    x, y = MARGIN, above + highest + 14
    for kind, name in KINDS.items():
        cv2.rectangle(sheet, (x, y), (x + 24, y + 14), TINTS[kind], 2)
        text.write(sheet, name, (x + 34, y + 12), 14, FAINT)
        x += 34 + text.width(name, 14) + 26
    for row, line in enumerate(lines):
        text.write(sheet, line, (MARGIN, y + 40 + 22 * row), 16, INK)
    return encode_png(sheet)


def _panel(side: Side, room: int) -> Pixels:
    """A photo with its marks, at most `room` pixels wide."""
    height, width = side.pixels.shape[:2]
    scale = min(room / width, PHOTO_HEIGHT / height)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    resized = cv2.resize(side.pixels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    drawn = np.asarray(resized, np.uint8).copy()
    names: list[tuple[str, tuple[int, int]]] = []
    for mark in side.marks:
        mask = cv2.resize(mark.cells.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(drawn, outlines, -1, PAPER, 5)
        cv2.drawContours(drawn, outlines, -1, TINTS[mark.kind], 3)
        left, top, wide, _ = cv2.boundingRect(mask)
        names.append((mark.name, (left + wide // 2, top - 4)))
    name_nodes(drawn, names, 13)
    return drawn
