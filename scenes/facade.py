"""Fronts of houses: walls with windows, doors, shops, cornices, drawn as textures."""

from dataclasses import dataclass

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Pixels
from scenes.materials import Colour

PER_METRE = 36

WALLS: tuple[Colour, ...] = (
    (196, 178, 146), (214, 203, 182), (183, 150, 118), (168, 176, 178), (204, 186, 120), (160, 110, 92),
    (222, 216, 206), (150, 158, 140), (190, 140, 110), (130, 140, 156), (176, 122, 80), (205, 170, 160),
)  # fmt: skip
BRICKS: tuple[Colour, ...] = ((150, 82, 62), (128, 70, 56), (172, 110, 80), (190, 160, 120), (110, 78, 70))
TRIMS: tuple[Colour, ...] = ((235, 232, 224), (210, 200, 180), (92, 88, 84), (150, 140, 128), (60, 66, 72))
DOORS: tuple[Colour, ...] = ((70, 44, 30), (32, 58, 48), (36, 46, 78), (110, 30, 28), (60, 60, 62), (120, 92, 52))
SHOPS: tuple[Colour, ...] = ((150, 32, 34), (24, 70, 110), (30, 92, 62), (196, 140, 30), (64, 40, 80), (40, 42, 46))


@dataclass(frozen=True)
class Style:
    """Appearance of a house; sizes in metres, colours RGB."""

    material: str
    wall: Colour
    trim: Colour
    storey: float
    window: tuple[float, float]
    pitch: float
    panes: tuple[int, int]
    shutters: Colour | None
    balconies: bool
    shop: Colour | None
    door: Colour
    arched: bool
    quoins: bool
    bands: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Style":
        """A random style."""
        material = str(rng.choice(["plaster", "plaster", "brick", "brick", "panels", "boards"]))
        colours = BRICKS if material == "brick" else WALLS
        width = float(rng.uniform(0.9, 1.5)) if material != "panels" else float(rng.uniform(1.4, 2.2))
        base = colours[rng.integers(len(colours))]
        wall = tuple(int(np.clip(c + rng.normal(0, 9), 30, 240)) for c in base)
        return cls(
            material=material,
            wall=(wall[0], wall[1], wall[2]),
            trim=TRIMS[rng.integers(len(TRIMS))],
            storey=float(rng.uniform(2.9, 3.7)),
            window=(width, float(rng.uniform(1.35, 2.0))),
            pitch=width + float(rng.uniform(0.7, 1.6)),
            panes=(int(rng.integers(1, 4)), int(rng.integers(1, 4))),
            shutters=DOORS[rng.integers(len(DOORS))] if material != "panels" and rng.random() < 0.3 else None,
            balconies=bool(rng.random() < 0.3),
            shop=SHOPS[rng.integers(len(SHOPS))] if rng.random() < 0.45 else None,
            door=DOORS[rng.integers(len(DOORS))],
            arched=bool(rng.random() < 0.2),
            quoins=bool(material != "panels" and rng.random() < 0.35),
            bands=bool(rng.random() < 0.5),
        )


def bare_wall(rng: np.random.Generator, style: Style, width: float, height: float) -> Pixels:
    """A wall of the style's material without openings, `width` x `height` metres."""
    size = (round(height * PER_METRE), round(width * PER_METRE))
    if style.material == "brick":
        return materials.brick(rng, size, style.wall, PER_METRE)
    if style.material == "panels":
        return materials.panels(rng, size, style.wall, PER_METRE)
    if style.material == "boards":
        return materials.boards(rng, size, style.wall, PER_METRE)
    return materials.plaster(rng, size, style.wall)


def front(rng: np.random.Generator, style: Style, width: float, height: float) -> tuple[Pixels, Pixels]:
    """Texture of a front of `width` x `height` metres and its glow at night, both RGB of the same shape."""
    wall = bare_wall(rng, style, width, height)
    glow = np.zeros_like(wall)
    storeys = max(1, int(height / style.storey))
    columns = max(1, int((width - 0.5) / style.pitch))
    margin = (width - columns * style.pitch) / 2
    for storey in range(storeys):
        sill = height - storey * style.storey  # metres from the top to this storey's floor
        if storey == 0:
            _ground_floor(rng, wall, glow, style, width, height)
            continue
        for column in range(columns):
            middle = margin + (column + 0.5) * style.pitch
            floor = sill - (style.storey - style.window[1]) * 0.45
            _window(rng, wall, glow, style, middle, floor)
        if style.balconies and storey < storeys:
            for column in range(int(rng.integers(2)), columns, 2):
                _balcony(wall, style, margin + (column + 0.5) * style.pitch, sill)
    if style.bands:
        for storey in range(1, storeys + 1):
            y = round((height - storey * style.storey) * PER_METRE)
            _band(wall, y, 5, style.trim)
    if style.quoins:
        _quoins(wall, style.trim)
    _band(wall, 0, 15, style.trim)
    wall[-12:] = (wall[-12:] * 0.7).astype(np.uint8)  # damp foot of the wall
    return wall, glow


def _box(x0: float, y0: float, x1: float, y1: float) -> tuple[int, int, int, int]:
    return round(x0 * PER_METRE), round(y0 * PER_METRE), round(x1 * PER_METRE), round(y1 * PER_METRE)


def _band(wall: Pixels, y: int, thickness: int, colour: Colour) -> None:
    """A moulding: light on top, a shadow under it."""
    wall[max(0, y) : y + thickness] = colour
    lit = wall[max(0, y) : y + max(1, thickness // 4)]
    lit[:] = np.minimum(lit.astype(np.int16) + 18, 255).astype(np.uint8)
    below = wall[y + thickness : y + thickness + 4]
    below[:] = (below * 0.62).astype(np.uint8)


def _quoins(wall: Pixels, colour: Colour) -> None:
    height, width = wall.shape[:2]
    for i, y in enumerate(range(0, height, 18)):
        reach = 22 if i % 2 else 14
        for x0, x1 in ((0, reach), (width - reach, width)):
            wall[y : y + 16, x0:x1] = colour
            wall[y + 16 : y + 18, x0:x1] = (np.array(colour) * 0.6).astype(np.uint8)


def _glass(rng: np.random.Generator, height: int, width: int) -> Pixels:
    """Panes: dark inside, the sky's reflection above, sometimes curtains."""
    top = np.array(rng.choice(np.array([[118, 138, 156], [88, 102, 116], [140, 156, 168]])), np.float32)
    ramp = np.linspace(1.0, 0.28, height, dtype=np.float32)[:, None, None]
    glass = np.broadcast_to(top * ramp, (height, width, 3)).copy()
    diagonal = (np.arange(width)[None, :] + np.arange(height)[:, None]) % max(12, width) < width // 5
    glass[diagonal] *= 1.14
    if rng.random() < 0.45:
        cloth = np.array(rng.choice(np.array([[205, 198, 186], [180, 160, 140], [150, 160, 170]])), np.float32)
        reach = int(width * rng.uniform(0.15, 0.4))
        folds = (0.72 + 0.14 * np.sin(np.arange(reach) * 1.5))[None, :, None]
        glass[:, :reach] = cloth * folds
        glass[:, width - reach :] = cloth * folds[:, ::-1]
    return np.clip(glass, 0, 255).astype(np.uint8)


def _lamp_light(rng: np.random.Generator, shape: tuple[int, ...]) -> Pixels:
    colour = np.array(rng.choice(np.array([[255, 206, 130], [255, 226, 176], [230, 232, 240]])), np.float32)
    ramp = np.linspace(0.95, 0.6, shape[0], dtype=np.float32)[:, None, None]
    return np.broadcast_to(colour * ramp * rng.uniform(0.5, 0.95), (*shape[:2], 3)).astype(np.uint8)


def _opening(wall: Pixels, area: tuple[int, int, int, int], inside: Pixels) -> None:
    """Recess `inside` into the wall: shadows along the upper and left edges."""
    x0, y0, x1, y1 = area
    wall[y0:y1, x0:x1] = inside
    wall[y0 : y0 + 4, x0:x1] = (wall[y0 : y0 + 4, x0:x1] * 0.45).astype(np.uint8)
    wall[y0:y1, x0 : x0 + 3] = (wall[y0:y1, x0 : x0 + 3] * 0.55).astype(np.uint8)


def _window(rng: np.random.Generator, wall: Pixels, glow: Pixels, style: Style, middle: float, floor: float) -> None:
    """One window whose sill is `floor` metres below the top of the wall."""
    w, h = style.window
    x0, y0, x1, y1 = _box(middle - w / 2, floor - h, middle + w / 2, floor)
    if y0 < 16 or x0 < 4 or x1 > wall.shape[1] - 4:
        return
    if style.material != "panels":
        wall[y0 - 4 : y1 + 2, x0 - 4 : x1 + 4] = style.trim
    if style.arched:
        cv2.ellipse(wall, ((x0 + x1) // 2, y0), ((x1 - x0) // 2 + 4, 12), 0, 180, 360, style.trim, -1)
    _opening(wall, (x0, y0, x1, y1), _glass(rng, y1 - y0, x1 - x0))
    lit = rng.random() < 0.42
    if lit:
        glow[y0:y1, x0:x1] = _lamp_light(rng, (y1 - y0, x1 - x0))
    for i in range(style.panes[0] + 1):
        x = x0 + round(i * (x1 - x0 - 2) / style.panes[0])
        wall[y0:y1, x : x + 2] = style.trim
        glow[y0:y1, x : x + 2] //= 4
    for i in range(style.panes[1] + 1):
        y = y0 + round(i * (y1 - y0 - 2) / style.panes[1])
        wall[y : y + 2, x0:x1] = style.trim
        glow[y : y + 2, x0:x1] //= 4
    wall[y1 : y1 + 4, x0 - 6 : x1 + 6] = np.clip(np.array(style.trim) + 12, 0, 255)
    under = wall[y1 + 4 : y1 + 8, x0 - 6 : x1 + 6]
    under[:] = (under * 0.6).astype(np.uint8)
    if style.shutters is not None:
        reach = round(w * PER_METRE * 0.42)
        for left in (x0 - 5 - reach, x1 + 5):
            leaf = wall[y0:y1, max(left, 0) : left + reach]
            slats = np.where(np.arange(y1 - y0) % 4 == 0, 0.6, 1.0)[:, None, None]
            leaf[:] = (np.array(style.shutters) * slats).astype(np.uint8)


def _balcony(wall: Pixels, style: Style, middle: float, floor: float) -> None:
    w = style.window[0] + 0.5
    x0, y0, x1, y1 = _box(middle - w / 2, floor - 0.95, middle + w / 2, floor + 0.1)
    x0, x1 = max(x0, 0), min(x1, wall.shape[1])
    if y0 < 0:
        return
    shadow = wall[y1 : y1 + 16, x0:x1]
    shadow[:] = (shadow * 0.55).astype(np.uint8)
    wall[y1 - 5 : y1, x0:x1] = style.trim
    for x in range(x0, x1 - 1, 5):
        wall[y0:y1, x : x + 1] = (38, 38, 40)
    wall[y0 : y0 + 2, x0:x1] = (38, 38, 40)


def _ground_floor(
    rng: np.random.Generator, wall: Pixels, glow: Pixels, style: Style, width: float, height: float
) -> None:
    if style.shop is not None and width > 4:
        _shop(rng, wall, glow, style, width, height)
        return
    door_at = float(rng.uniform(1.2, width - 1.2)) if width > 3 else width / 2
    x = 1.0
    while x + style.window[0] < width - 0.5:
        middle = x + style.window[0] / 2
        if abs(middle - door_at) > style.window[0] / 2 + 0.9:
            _window(rng, wall, glow, style, middle, height - 0.9)
        x += style.pitch
    _door(rng, wall, glow, style, door_at, height)


def _door(rng: np.random.Generator, wall: Pixels, glow: Pixels, style: Style, middle: float, height: float) -> None:
    x0, y0, x1, y1 = _box(middle - 0.55, height - 2.5, middle + 0.55, height - 0.08)
    y0 = max(y0, 4)
    wall[y0 - 5 : y1, max(0, x0 - 6) : x1 + 6] = style.trim
    leaf = np.broadcast_to(np.array(style.door, np.uint8), (y1 - y0, x1 - x0, 3)).copy()
    for top, bottom in ((0.32, 0.58), (0.64, 0.94)):
        for left, right in ((0.12, 0.46), (0.54, 0.88)):
            ys, xs = (
                slice(int(top * (y1 - y0)), int(bottom * (y1 - y0))),
                slice(int(left * (x1 - x0)), int(right * (x1 - x0))),
            )
            leaf[ys, xs] = (np.array(style.door) * 0.7).astype(np.uint8)
    leaf[: (y1 - y0) // 4] = _glass(rng, (y1 - y0) // 4, x1 - x0)
    glow[y0 : y0 + (y1 - y0) // 4, x0:x1] = (200, 150, 90)
    _opening(wall, (x0, y0, x1, y1), leaf)
    cv2.circle(wall, (x1 - 6, (y0 + y1) // 2 + 8), 2, (200, 180, 110), -1)
    wall[y1:, max(0, x0 - 8) : x1 + 8] = (150, 146, 140)


def _shop(rng: np.random.Generator, wall: Pixels, glow: Pixels, style: Style, width: float, height: float) -> None:
    """A shop: fascia with lettering, large panes, a glazed door, sometimes a striped awning."""
    colour = style.shop or SHOPS[0]
    top = height - style.storey + 0.15
    x0, y0, x1, y1 = _box(0.3, top, width - 0.3, height)
    wall[y0:y1, x0:x1] = (np.array(colour) * 0.55).astype(np.uint8)
    fascia = round(0.62 * PER_METRE)
    wall[y0 : y0 + fascia, x0:x1] = colour
    letters = "".join(chr(int(rng.integers(65, 91))) for _ in range(int(rng.integers(4, 8))))
    scale = fascia / 34
    (text_width, text_height), _ = cv2.getTextSize(letters, cv2.FONT_HERSHEY_TRIPLEX, scale, 1)
    at = ((x0 + x1 - text_width) // 2, y0 + (fascia + text_height) // 2)
    cv2.putText(wall, letters, at, cv2.FONT_HERSHEY_TRIPLEX, scale, (236, 228, 206), 1, cv2.LINE_AA)
    cv2.putText(glow, letters, at, cv2.FONT_HERSHEY_TRIPLEX, scale, (250, 230, 190), 1, cv2.LINE_AA)
    panes = max(2, round((x1 - x0) / PER_METRE / 1.9))
    door = int(rng.integers(panes))
    step = (x1 - x0) / panes
    for i in range(panes):
        left, right = round(x0 + i * step) + 4, round(x0 + (i + 1) * step) - 4
        low = y1 - 6 if i == door else y1 - round(0.5 * PER_METRE)
        high = y0 + fascia + 5
        inside = _glass(rng, low - high, right - left)
        for _ in range(9):  # goods in the window
            gx, gy = int(rng.integers(right - left)), int(rng.integers((low - high) // 2, low - high))
            goods = tuple(int(c) for c in rng.integers(40, 210, 3))
            cv2.rectangle(inside, (gx, gy), (gx + int(rng.integers(4, 14)), low - high), goods, -1)
        _opening(wall, (left, high, right, low), inside)
        glow[high:low, left:right] = np.maximum(inside, 60) * 0.5 + np.array([110, 92, 60])
    if rng.random() < 0.5:
        reach = round(0.75 * PER_METRE)
        stripes = (np.arange(x1 - x0) // 14 % 2 == 0)[None, :, None]
        light = np.linspace(1.05, 0.8, reach)[:, None, None]
        cloth = np.where(stripes, np.array(colour), np.array([232, 226, 214])) * light
        wall[y0 + fascia : y0 + fascia + reach, x0:x1] = np.clip(cloth, 0, 255).astype(np.uint8)
        glow[y0 + fascia : y0 + fascia + reach, x0:x1] = 0
        below = wall[y0 + fascia + reach : y0 + fascia + reach + 14, x0:x1]
        below[:] = (below * 0.6).astype(np.uint8)
