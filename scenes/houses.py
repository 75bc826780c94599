"""Houses: a front, side walls, a roof, sometimes chimneys."""

import numpy as np

from scenes import materials
from scenes.facade import Style, bare_wall, front
from scenes.furniture import metal
from scenes.geometry import Place, Surface, Vector, box, vector
from scenes.materials import Colour
from scenes.words import label

BUILDING = label("building")
ROOFS: tuple[Colour, ...] = ((132, 66, 48), (92, 60, 52), (74, 76, 82), (104, 84, 70), (150, 84, 58))


def house(
    place: Place,
    rng: np.random.Generator,
    corner: tuple[float, float],
    along: tuple[float, float],
    width: float,
    height: float,
    depth: float = 9.0,
) -> None:
    """Build a house whose front begins at `corner` (its left end, seen from outside) and runs `along` (unit x, y).

    The front faces ``(along[1], -along[0])``. Sizes in metres.
    """
    style = Style.drawn(rng)
    ax, ay = along
    out = np.array([ay, -ax])  # from the front towards the street
    across = vector(ax * width, ay * width, 0)
    left = vector(*corner, 0)
    back = vector(-out[0] * depth, -out[1] * depth, 0)
    texture, glow = front(rng, style, width, height)
    down, up = vector(0, 0, -height), vector(0, 0, height)
    place.surfaces.append(Surface(left + up, across, down, texture, BUILDING, glow))
    side = bare_wall(rng, style, depth, height)
    side = (side * np.float32(0.93)).astype(np.uint8)
    place.surfaces.append(Surface(left + back + up, -back, down, side, BUILDING))
    place.surfaces.append(Surface(left + across + up, back, down, side, BUILDING))
    _roof(place, rng, left, across, back, height)
    footprint = np.stack([left, left + across, left + across + back, left + back])
    footprint[:, 2] = height
    place.shadows.append(footprint)


def _roof(place: Place, rng: np.random.Generator, left: Vector, across: Vector, back: Vector, height: float) -> None:
    """A pitched roof with its eaves along the front, one with its gable in front, or a flat roof with a parapet."""
    kind = rng.random()
    up = vector(0, 0, height)
    width, depth = float(np.linalg.norm(across)), float(np.linalg.norm(back))
    colour = ROOFS[rng.integers(len(ROOFS))]
    eaves = -0.35 * back / depth
    if kind < 0.55:
        rise = float(rng.uniform(1.8, 3.4))
        ridge = left + up + back / 2 + vector(0, 0, rise)
        size = (max(8, round(np.hypot(depth / 2, rise) * 30)), max(8, round(width * 30)))
        tiles = materials.roof_tiles(rng, size, colour)
        eave = left + up + eaves - vector(0, 0, 0.12)
        place.surfaces.append(Surface(ridge, across, eave - ridge, tiles, BUILDING))
        place.surfaces.append(Surface(ridge + across, -across, left + up + back - ridge, tiles, BUILDING))
        gable = _gable(materials.plaster(rng, (96, 128), (196, 188, 176)))
        for foot in (left + up, left + up + across):
            low = foot + back
            place.surfaces.append(Surface(low + vector(0, 0, rise), foot - low, vector(0, 0, -rise), gable, BUILDING))
        for _ in range(int(rng.integers(1, 3))):
            spot = ridge + across * float(rng.uniform(0.15, 0.85))
            wall = materials.brick(rng, (48, 24), (140, 84, 66), 36)
            x, y, z = spot
            place.surfaces += box((x - 0.35, x + 0.35), (y - 0.35, y + 0.35), (z - 0.8, z + 1.1), wall, BUILDING)
    elif kind < 0.75:
        rise = float(rng.uniform(2.0, 3.2))
        size = (round(rise * 36), round(width * 36))
        gable = _gable(materials.plaster(rng, size, (206, 196, 178)))
        place.surfaces.append(Surface(left + up + vector(0, 0, rise), across, vector(0, 0, -rise), gable, BUILDING))
        ridge = left + up + across / 2 + vector(0, 0, rise)
        tiles = materials.roof_tiles(rng, (round(np.hypot(width / 2, rise) * 30), round(depth * 30)), colour)
        for foot, sign in ((left + up, 1), (left + up + across, -1)):
            start, run = (ridge + back, -back) if sign > 0 else (ridge, back)
            place.surfaces.append(Surface(start, run, foot - ridge, tiles, BUILDING))
    else:
        lip = metal((120, 120, 124), 8, 16)
        place.surfaces.append(Surface(left + up + eaves + vector(0, 0, 0.5), across, vector(0, 0, -0.5), lip, BUILDING))


def _gable(wall: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """The wall cut to a triangle with its apex up, RGBA."""
    rows, columns = wall.shape[:2]
    t = (np.arange(rows) + 0.5)[:, None] / rows
    s = np.abs((np.arange(columns) + 0.5)[None, :] / columns - 0.5) * 2
    return np.dstack([wall, np.where(s <= t, 255, 0).astype(np.uint8)])
