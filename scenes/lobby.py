"""Lobbies of look-alike floors: an open hall with a reception desk, two lifts, seats and windows."""

import numpy as np

from scenes import materials
from scenes.corridor import ACCENTS, PAINTS, hang_ceiling, lay_floor, plain_wall, put_wall, put_window
from scenes.furniture import BENCH, POLE
from scenes.geometry import Lamp, Place, Surface, Viewpoint, box, vector
from scenes.materials import Colour
from scenes.storeys import Slot, Storey, facing, on_wall
from scenes.words import label

STEP = 1.2
"""Metres between spots."""

WOODS: tuple[Colour, ...] = ((150, 108, 70), (184, 148, 104), (118, 90, 72), (208, 206, 200))
CLOTHS: tuple[Colour, ...] = ((72, 92, 112), (124, 84, 68), (96, 104, 84), (84, 82, 88))


def lobby(rng: np.random.Generator, spots: int) -> Storey:
    """The shell of a hall, deep enough for `spots` steps from its entrance to the reception desk."""
    half, height = float(rng.uniform(4.2, 5.2)), float(rng.uniform(3.0, 3.4))
    depth = spots * STEP + 5.5
    place = Place(start=Viewpoint(), indoors=True, stands={"person": (0.4, 4.2, 0.0)})
    paint, accent = PAINTS[rng.integers(len(PAINTS))], ACCENTS[rng.integers(len(ACCENTS))]
    for sign in (-1, 1):
        texture, labels, glow = plain_wall(rng, depth + 2.5, height, paint, accent, 0.0)
        x = 2.8
        while sign < 0 and x < depth - 0.5:  # daylight comes from the left
            put_window(rng, texture, labels, glow, x, height)
            x += 2.6
        put_wall(place, texture, labels, glow, sign, half, height, depth)
    texture, labels, glow = plain_wall(rng, 2 * half, height, paint, accent, 0.0)
    place.surfaces.append(
        Surface(vector(-half, depth, height), vector(2 * half, 0, 0), vector(0, 0, -height), texture, labels, glow)
    )
    lay_floor(place, rng, half, depth)
    hang_ceiling(place, rng, half, height, depth)
    _downlights(place, half, height, depth)
    slots: list[Slot] = []
    _reception(place, rng, slots, half, depth)
    _lifts(place, slots, half, depth)
    _seats(place, rng, half, depth)
    _right_wall(place, rng, slots, half, depth)
    for x, y in ((-half + 0.5, depth - 0.5), (half - 0.45, 0.42 * depth), (-half + 0.5, 0.3 * depth)):
        slots.append(Slot("plant", vector(x, y, 0)))
    aside = float(rng.uniform(-0.2, 0.2)) * half
    turns = [float(rng.uniform(10, 18)) * (1 if i % 2 else -1) for i in range(spots)]
    walk = [
        Viewpoint(dx=aside + 0.5 * (-1) ** i, ahead=-0.5 + i * STEP, turn=turn, up=-0.05)
        for i, turn in enumerate(turns)
    ]
    return Storey(place, slots, walk, accent, paint)


def _downlights(place: Place, half: float, height: float, depth: float) -> None:
    glass, shine = np.full((8, 8, 3), 232, np.uint8), np.full((8, 8, 3), (255, 250, 236), np.uint8)
    for x in (-0.62 * half, 0.62 * half):
        for y in np.arange(1.0, depth, 2.6):
            for part in box((x - 0.14, x + 0.14), (y - 0.14, y + 0.14), (height - 0.05, height), glass, 0):
                place.surfaces.append(Surface(part.origin, part.across, part.down, glass, label("lamp"), shine))
            place.lamps.append(Lamp((float(x), float(y), height - 0.25), (0.30, 0.29, 0.27), reach=1.5))


def _reception(place: Place, rng: np.random.Generator, slots: list[Slot], half: float, depth: float) -> None:
    """A desk before the far wall, left of the middle, with the firm's name on the wall behind it."""
    wood = WOODS[rng.integers(len(WOODS))]
    x0, x1, y = -0.72 * half, -0.02 * half, depth - 2.3
    front = materials.bark(rng, (66, 240), wood) // 3 + (np.array(wood) * 0.6).astype(np.uint8)
    front[:, ::60] = (np.array(wood) * 0.45).astype(np.uint8)
    top = np.full((8, 8, 3), (70, 70, 74), np.uint8)
    place.surfaces += box((x0, x1), (y, y + 0.7), (0, 1.08), front, BENCH, top=top)
    place.surfaces += box((x0 - 0.06, x1 + 0.06), (y - 0.08, y + 0.4), (1.08, 1.13), top, BENCH)
    screen = np.full((8, 8, 3), (30, 32, 36), np.uint8)
    middle = (x0 + x1) / 2
    place.surfaces += box((middle - 0.25, middle + 0.25), (y + 0.45, y + 0.49), (1.13, 1.42), screen, BENCH)
    slots.append(facing("company", middle, depth, 2.15, (1.7, 0.46)))
    slots.append(facing("stripe", middle, y, 0.86, (x1 - x0, 0.06)))


def _lifts(place: Place, slots: list[Slot], half: float, depth: float) -> None:
    """Two lifts in the far wall, right of the middle, each with a display, and the level between them."""
    steel = np.full((160, 80, 3), (168, 172, 176), np.uint8)
    steel[:, 39:41] = (70, 72, 74)
    steel[:6], steel[:, :5], steel[:, -5:] = (110, 114, 118), (110, 114, 118), (110, 114, 118)
    shade = np.linspace(1.06, 0.86, 160)[:, None, None]
    steel = np.clip(steel * shade, 0, 255).astype(np.uint8)
    for x in (0.22 * half, 0.68 * half):
        door = facing("lift", x, depth, 1.07, (1.1, 2.14))
        place.surfaces.append(Surface(door.origin, door.across, door.down, steel, label("door")))
        slots.append(facing("lift", x, depth, 2.32, (0.34, 0.2)))
    middle = 0.45 * half
    slots.append(facing("level", middle, depth, 1.75, (0.36, 0.46)))
    knob = facing("lift", middle, depth, 1.15, (0.1, 0.2))
    button = np.full((20, 10, 3), (190, 192, 194), np.uint8)
    button[4:8, 3:7], button[12:16, 3:7] = (60, 62, 64), (60, 62, 64)
    place.surfaces.append(Surface(knob.origin, knob.across, knob.down, button, label("sign")))


def _seats(place: Place, rng: np.random.Generator, half: float, depth: float) -> None:
    """Two sofas and a low table at the windows, and a pair of columns."""
    cloth = materials.plaster(rng, (40, 80), CLOTHS[rng.integers(len(CLOTHS))])
    wood = np.full((8, 8, 3), WOODS[rng.integers(len(WOODS))], np.uint8)
    wall = -half + 0.25
    for y in (0.38 * depth, 0.38 * depth + 2.3):
        place.surfaces += box((wall, wall + 0.8), (y, y + 1.7), (0.08, 0.42), cloth, BENCH)
        place.surfaces += box((wall, wall + 0.22), (y, y + 1.7), (0.42, 0.78), cloth, BENCH)
    table = wall + 1.15
    place.surfaces += box((table, table + 0.5), (0.38 * depth + 1.3, 0.38 * depth + 2.5), (0, 0.4), wood, BENCH)
    column = materials.plaster(rng, (140, 16), (206, 204, 198))
    for x in (-0.45 * half, 0.55 * half):
        y = 0.62 * depth
        place.surfaces += box((x - 0.17, x + 0.17), (y - 0.17, y + 0.17), (0, 3.5), column, POLE)


def _right_wall(place: Place, rng: np.random.Generator, slots: list[Slot], half: float, depth: float) -> None:
    """Posters, the directory of the building and a notice board, in an order of this building's own."""
    y = 2.2
    for what in rng.permutation(["poster", "directory", "poster", "board"]):
        if what == "directory":
            slots.append(on_wall("directory", half, y, 1.55, (0.8, 1.1)))
        elif what == "board":
            slots.append(on_wall("board", half, y, 1.5, (1.2, 0.85)))
        else:
            slots.append(on_wall("poster", half, y, 1.55, (0.7, 1.0), everywhere=bool(rng.random() < 0.3)))
        y += (depth - 3.0) / 4
