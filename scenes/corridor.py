"""Corridors: floor, ceiling with lamps, walls with doors, windows, notice boards and paintings."""

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Lamp, Pixels, Place, Surface, Viewpoint, box, vector
from scenes.materials import Colour
from scenes.words import label

PER_METRE = 48
BEHIND = -2.5
WALL, DOOR, WINDOW, SIGN = label("wall"), label("door"), label("window"), label("sign")
PAINTS: tuple[Colour, ...] = (
    (222, 216, 200), (206, 212, 208), (226, 210, 176), (188, 202, 212), (212, 196, 188), (196, 206, 178),
    (232, 230, 226),
)  # fmt: skip
ACCENTS: tuple[Colour, ...] = (
    (60, 104, 132),
    (140, 62, 52),
    (70, 112, 78),
    (186, 150, 70),
    (88, 84, 110),
    (110, 92, 76),
)


def corridor(rng: np.random.Generator) -> Place:
    """A corridor that runs away from the camera."""
    half, height, length = float(rng.uniform(1.05, 1.9)), float(rng.uniform(2.5, 3.2)), float(rng.uniform(12, 26))
    place = Place(
        start=Viewpoint(dx=float(rng.uniform(-0.35, 0.35)) * half, turn=float(rng.uniform(-13, 13)), up=-0.1),
        indoors=True,
    )
    paint, accent = PAINTS[rng.integers(len(PAINTS))], ACCENTS[rng.integers(len(ACCENTS))]
    doors = ((122, 84, 52), (176, 140, 98), (226, 224, 218), accent, (90, 96, 104))[rng.integers(5)]
    dado = float(rng.uniform(0.8, 1.3)) if rng.random() < 0.5 else 0.0
    for side, sign in ((0, -1), (1, 1)):
        windows = side == 1 and rng.random() < 0.4
        texture, labels, glow = _wall(rng, length - BEHIND, height, paint, accent, doors, dado, windows=windows)
        put_wall(place, texture, labels, glow, sign, half, height, length)
    lay_floor(place, rng, half, length)
    hang_ceiling(place, rng, half, height, length)
    texture, labels, glow = _end(rng, 2 * half, height, paint, accent, doors, dado)
    place.surfaces.append(
        Surface(vector(-half, length, height), vector(2 * half, 0, 0), vector(0, 0, -height), texture, labels, glow)
    )
    _furnish(place, rng, half, length, accent)
    place.stands = {
        "bus": (0.0, 9.0, 0.0),
        "car": (0.0, 7.0, 0.0),
        "person": (float(rng.uniform(-0.5, 0.5)) * half, 3.6, 0.0),
    }
    return place


def put_wall(
    place: Place, texture: Pixels, labels: Pixels, glow: Pixels, sign: int, half: float, height: float, length: float
) -> None:
    """Add a wall in pieces of about 3 m, each drawn at the resolution that its distance needs."""
    total = length - BEHIND
    pieces = max(1, round(total / 3))
    columns = texture.shape[1]
    for i in range(pieces):
        a, b = i / pieces, (i + 1) / pieces
        cut = slice(round(a * columns), round(b * columns))
        # Columns run left to right as seen from inside: away from the camera on the left wall, back on the right.
        y0 = BEHIND + a * total if sign < 0 else length - a * total
        across = vector(0, -sign * total / pieces, 0)
        place.surfaces.append(
            Surface(
                vector(sign * half, y0, height),
                across,
                vector(0, 0, -height),
                np.ascontiguousarray(texture[:, cut]),
                np.ascontiguousarray(labels[:, cut]),
                np.ascontiguousarray(glow[:, cut]),
            )
        )


def plain_wall(
    rng: np.random.Generator, length: float, height: float, paint: Colour, accent: Colour, dado: float
) -> tuple[Pixels, Pixels, Pixels]:
    """Texture, labels and glow of a bare wall, its lower `dado` metres in the accent colour."""
    size = (round(height * PER_METRE), round(length * PER_METRE))
    texture = materials.plaster(rng, size, paint)
    if dado:
        low = size[0] - round(dado * PER_METRE)
        texture[low:] = materials.plaster(rng, (size[0] - low, size[1]), accent)
        texture[low - 4 : low] = (np.array(accent) * 0.6).astype(np.uint8)
    texture[-round(0.1 * PER_METRE) :] = (np.array(accent) * 0.45).astype(np.uint8)
    return texture, np.full(size, WALL, np.uint8), np.zeros_like(texture)


def _wall(
    rng: np.random.Generator,
    length: float,
    height: float,
    paint: Colour,
    accent: Colour,
    doors: Colour,
    dado: float,
    *,
    windows: bool,
) -> tuple[Pixels, Pixels, Pixels]:
    texture, labels, glow = plain_wall(rng, length, height, paint, accent, dado)
    x = float(rng.uniform(0.3, 1.6))
    while x < length - 1.2:
        kind = rng.random()
        if windows and kind < 0.6:
            x += put_window(rng, texture, labels, glow, x, height)
        elif kind < 0.42:
            x += _door(rng, texture, labels, doors, x)
        elif kind < 0.62:
            x += _board(rng, texture, labels, x, height)
        elif kind < 0.85:
            x += _image(rng, texture, labels, x, height)
        else:
            x += _extinguisher(texture, labels, x)
        x += float(rng.uniform(0.3, 1.5))
    return texture, labels, glow


def _end(
    rng: np.random.Generator, width: float, height: float, paint: Colour, accent: Colour, doors: Colour, dado: float
) -> tuple[Pixels, Pixels, Pixels]:
    texture, labels, glow = plain_wall(rng, width, height, accent if rng.random() < 0.4 else paint, accent, dado)
    kind = rng.random()
    if kind < 0.45:
        _door(rng, texture, labels, doors, width / 2 - 0.5)
        cv2.rectangle(texture, (texture.shape[1] // 2 - 16, 8), (texture.shape[1] // 2 + 16, 22), (30, 130, 70), -1)
        glow[8:22, texture.shape[1] // 2 - 16 : texture.shape[1] // 2 + 16] = (40, 170, 90)
    elif kind < 0.8:
        put_window(rng, texture, labels, glow, max(0.1, width / 2 - 0.8), height)
    else:
        _image(rng, texture, labels, width / 2 - 0.5, height)
    return texture, labels, glow


def _area(texture: Pixels, x: float, width: float, top: float, bottom: float) -> tuple[slice, slice]:
    """Rows and columns of a rectangle, in metres: `x`, `width` from the wall's left end, the others above the floor."""
    rows, columns = texture.shape[:2]
    left, right = round(x * PER_METRE), min(columns, round((x + width) * PER_METRE))
    return slice(max(0, rows - round(top * PER_METRE)), rows - round(bottom * PER_METRE)), slice(left, right)


def _framed(texture: Pixels, area: tuple[slice, slice], colour: Colour, thickness: int) -> None:
    ys, xs = area
    texture[max(0, ys.start - thickness) : ys.stop + thickness, max(0, xs.start - thickness) : xs.stop + thickness] = (
        colour
    )


def _door(rng: np.random.Generator, texture: Pixels, labels: Pixels, colour: Colour, x: float) -> float:
    width = float(rng.choice([0.95, 0.95, 1.6]))
    area = _area(texture, x, width, 2.1, 0.0)
    _framed(texture, area, tuple(int(c * 0.62) for c in colour), 5)  # type: ignore[arg-type]
    ys, xs = area
    shape = (ys.stop - ys.start, xs.stop - xs.start)
    texture[area] = materials.bark(rng, shape, colour) // 3 + (np.array(colour) * 0.66).astype(np.uint8)
    labels[area] = DOOR
    if rng.random() < 0.4:
        pane = _area(texture, x + width * 0.3, width * 0.4, 1.85, 1.15)
        texture[pane] = (140, 156, 160)
    handle = _area(texture, x + width * 0.82, 0.1, 1.06, 1.0)
    texture[handle] = (196, 196, 190)
    plate = _area(texture, x + width + 0.12, 0.22, 1.65, 1.5)
    texture[plate] = (246, 244, 236)
    ys, xs = plate
    number = str(rng.integers(100, 400))
    cv2.putText(texture, number, (xs.start, ys.stop - 1), cv2.FONT_HERSHEY_PLAIN, 0.5, (30, 30, 30), 1)
    return width + 0.3


def put_window(
    rng: np.random.Generator, texture: Pixels, labels: Pixels, glow: Pixels, x: float, height: float
) -> float:
    """Paint a window into a wall, `x` metres from its left end; returns its width in metres."""
    width = float(rng.uniform(1.2, 1.9))
    area = _area(texture, x, width, min(height - 0.25, 2.35), 0.85)
    ys, xs = area
    rows, columns = ys.stop - ys.start, xs.stop - xs.start
    if rows < 4 or columns < 4:
        return width
    _framed(texture, area, (238, 238, 234), 5)
    view = np.linspace(0, 1, rows, dtype=np.float32)[:, None, None]
    outside = (1 - view) * np.array([196, 214, 230]) + view * np.array([150, 166, 150])
    texture[area] = np.broadcast_to(outside, (rows, columns, 3)).astype(np.uint8)
    labels[area] = WINDOW
    for share in (0.5,):
        texture[ys, xs.start + int(share * columns) : xs.start + int(share * columns) + 3] = (238, 238, 234)
    return width


def _board(rng: np.random.Generator, texture: Pixels, labels: Pixels, x: float, height: float) -> float:
    width = float(rng.uniform(0.9, 1.7))
    area = _area(texture, x, width, 1.95, 1.0)
    _framed(texture, area, (120, 92, 60), 3)
    ground = ((178, 140, 92), (52, 92, 72), (232, 232, 228))[rng.integers(3)]
    texture[area] = ground
    labels[area] = SIGN
    ys, xs = area
    for _ in range(int(rng.integers(4, 10))):
        left = int(rng.integers(xs.start + 2, max(xs.start + 3, xs.stop - 16)))
        top = int(rng.integers(ys.start + 2, max(ys.start + 3, ys.stop - 18)))
        sheet = tuple(
            int(c)
            for c in np.array([(250, 248, 240), (250, 236, 130), (190, 220, 240), (244, 190, 190)])[rng.integers(4)]
        )
        right, bottom = min(left + int(rng.integers(9, 15)), xs.stop - 1), min(top + 16, ys.stop - 1)
        cv2.rectangle(texture, (left, top), (right, bottom), sheet, -1)
        for line in range(top + 3, bottom - 1, 3):
            cv2.line(texture, (left + 2, line), (right - 2, line), (110, 110, 110), 1)
    return width


def _image(rng: np.random.Generator, texture: Pixels, labels: Pixels, x: float, height: float) -> float:
    width, tall = float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.45, 0.9))
    area = _area(texture, x, width, 1.55 + tall / 2, 1.55 - tall / 2)
    _framed(texture, area, ((40, 36, 34), (190, 160, 90), (236, 234, 230))[rng.integers(3)], 4)
    ys, xs = area
    shape = (ys.stop - ys.start, xs.stop - xs.start)
    colours = rng.integers(40, 230, (2, 3))
    field = np.clip(materials.noise(rng, shape, 18, 3) * 0.5 + 0.5, 0, 1)[..., None]
    texture[area] = (colours[0] * field + colours[1] * (1 - field)).astype(np.uint8)
    labels[area] = SIGN
    return width


def _extinguisher(texture: Pixels, labels: Pixels, x: float) -> float:
    area = _area(texture, x, 0.17, 1.15, 0.6)
    texture[area] = (190, 24, 26)
    ys, xs = area
    texture[ys.start - 6 : ys.start, xs.start + 2 : xs.start + 6] = (30, 30, 30)
    plate = _area(texture, x - 0.02, 0.22, 1.9, 1.65)
    texture[plate] = (200, 30, 32)
    labels[plate] = SIGN
    return 0.3


def lay_floor(place: Place, rng: np.random.Generator, half: float, length: float) -> None:
    """Give an indoor place a floor of tiles, boards or linoleum, `half` metres to either side."""
    place.ground = (-half, half, BEHIND, length)
    size = (round((length - BEHIND) * PER_METRE), round(2 * half * PER_METRE))
    kind = int(rng.integers(4))
    tone = ((150, 142, 130), (120, 124, 128), (170, 150, 120), (112, 92, 76), (96, 112, 118))[rng.integers(5)]
    if kind == 0:
        texture = materials.paving(rng, size, tone, (24, 24), bond=False)
    elif kind == 1:
        squares = (np.arange(size[0])[:, None] // 22 + np.arange(size[1])[None, :] // 22) % 2
        light = 0.78 + 0.34 * squares + 0.02 * rng.standard_normal(size)
        texture = materials.tinted(tone, light.astype(np.float32))
    elif kind == 2:
        texture = materials.paving(rng, (size[1], size[0]), tone, (7, 60)).transpose(1, 0, 2)
    else:
        light = 1 + 0.05 * materials.noise(rng, size, 30) + 0.06 * rng.standard_normal(size)
        texture = materials.tinted(tone, light.astype(np.float32))
    place.ground_texture = np.ascontiguousarray(texture)
    place.ground_labels = np.full(size, label("floor"), np.uint8)


def hang_ceiling(place: Place, rng: np.random.Generator, half: float, height: float, length: float) -> None:
    """Give an indoor place a ceiling with a row of lamps."""
    size = (round((length - BEHIND) * 30), round(2 * half * 30))
    tiled = rng.random() < 0.6
    if tiled:
        texture = materials.paving(rng, size, (206, 206, 202), (18, 18), bond=False)
    else:
        texture = materials.plaster(rng, size, (212, 210, 206))
    place.surfaces.append(
        Surface(
            vector(-half, BEHIND, height),
            vector(2 * half, 0, 0),
            vector(0, length - BEHIND, 0),
            texture[::-1].copy(),
            label("ceiling"),
        )
    )
    long = rng.random() < 0.5
    glass = np.full((8, 8, 3), 232, np.uint8)
    shine = np.full((8, 8, 3), (255, 250, 236), np.uint8)
    for y in np.arange(float(rng.uniform(0.5, 2.0)), length, float(rng.uniform(2.2, 3.8))):
        wide, deep = (0.28, 1.2) if long else (min(1.2, half), 0.3)
        for part in box((-wide / 2, wide / 2), (y - deep / 2, y + deep / 2), (height - 0.07, height), glass, 0):
            place.surfaces.append(Surface(part.origin, part.across, part.down, glass, label("lamp"), shine))
        place.lamps.append(Lamp((0.0, float(y), height - 0.25), (0.36, 0.35, 0.33), reach=1.5))


def _furnish(place: Place, rng: np.random.Generator, half: float, length: float, accent: Colour) -> None:
    """Cupboards and benches along the walls."""
    for _ in range(int(rng.integers(1, 5))):
        sign = int(rng.choice([-1, 1]))
        y = float(rng.uniform(3.0, max(4, length - 3)))
        deep, wide, tall = float(rng.uniform(0.3, 0.42)), float(rng.uniform(0.5, 1.2)), float(rng.uniform(0.45, 1.9))
        colour = ((150, 118, 84), (176, 178, 180), accent, (92, 96, 98))[rng.integers(4)]
        face = materials.plaster(rng, (round(tall * 40), round(wide * 40)), colour)
        face[:, :: max(8, face.shape[1] // 2)] = (np.array(colour) * 0.5).astype(np.uint8)
        face[:: max(10, face.shape[0] // 3)] = (np.array(colour) * 0.5).astype(np.uint8)
        x = tuple(sorted((sign * half, sign * (half - deep))))
        place.surfaces += box((x[0], x[1]), (y, y + wide), (0, tall), face, label("bench"))
