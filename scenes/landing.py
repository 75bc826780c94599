"""Corridors of look-alike floors: numbered doors to both sides, notices between them."""

import numpy as np

from scenes import materials
from scenes.corridor import ACCENTS, PAINTS, hang_ceiling, lay_floor, plain_wall, put_wall, put_window
from scenes.furniture import SIGN, metal
from scenes.geometry import Pixels, Place, Surface, Viewpoint, box, vector
from scenes.materials import Colour
from scenes.storeys import PROUD, Slot, Storey, jutting, on_wall
from scenes.words import label

STEP = 1.5
"""Metres between spots."""

MODULE = 3.0
"""Metres from door to door along a wall."""

DOORS: tuple[Colour, ...] = ((150, 104, 66), (176, 140, 98), (206, 204, 198), (96, 104, 112))


def landing(rng: np.random.Generator, spots: int) -> Storey:
    """The shell of a corridor that runs away from the camera, long enough for `spots` steps."""
    half, height = float(rng.uniform(1.15, 1.5)), float(rng.uniform(2.5, 2.8))
    length = spots * STEP + 8.0
    place = Place(start=Viewpoint(), indoors=True, stands={"person": (0.1 * half, 5.0, 0.0)})
    paint, accent = PAINTS[rng.integers(len(PAINTS))], ACCENTS[rng.integers(len(ACCENTS))]
    dado = float(rng.uniform(0.8, 1.1)) if rng.random() < 0.5 else 0.0
    for sign in (-1, 1):
        put_wall(place, *plain_wall(rng, length + 2.5, height, paint, accent, dado), sign, half, height, length)
    lay_floor(place, rng, half, length)
    hang_ceiling(place, rng, half, height, length)
    _end(place, rng, half, height, length, paint, accent, dado)
    slots: list[Slot] = []
    doors = _along_the_walls(place, rng, slots, half, length)
    side = float(rng.uniform(-0.25, 0.25)) * half
    turns = [float(rng.uniform(9, 17)) * (1 if i % 2 else -1) for i in range(spots)]
    walk = [Viewpoint(dx=side, ahead=i * STEP, turn=turn, up=-0.05) for i, turn in enumerate(turns)]
    return Storey(place, slots, walk, accent, paint, doors)


def _along_the_walls(place: Place, rng: np.random.Generator, slots: list[Slot], half: float, length: float) -> int:
    """Add doors and furniture to both walls and slots between them; returns how many doors there are."""
    wood = materials.bark(rng, (round(2.05 * 60), round(0.92 * 60)), DOORS[rng.integers(len(DOORS))])
    leaf = _leaf(wood)
    doors = 0
    for sign in (-1, 1):
        wall = sign * half
        y = 0.6 + (MODULE / 2 if sign > 0 else 0.0) + float(rng.uniform(0, 0.4))
        number = 1 if sign < 0 else 2
        between = rng.permutation(["poster", "board", "plant", "cupboard", "level", "hose"])
        turn = 0
        while y < length - 1.6:
            door = on_wall("note", wall, y, 1.025, (0.96, 2.05))
            place.surfaces.append(Surface(door.origin, door.across, door.down, leaf, label("door")))
            doors += 1
            slots.append(jutting("number", wall, y - 0.6, 1.9, (0.26, 0.17), number))
            slots.append(on_wall("note", wall - sign * PROUD, y, 1.5, (0.21, 0.3)))
            number += 2
            _between(place, rng, slots, str(between[turn % len(between)]), wall, y + MODULE / 2)
            turn += 1
            y += MODULE
    return doors


def _between(place: Place, rng: np.random.Generator, slots: list[Slot], what: str, wall: float, y: float) -> None:
    sign = -1.0 if wall < 0 else 1.0
    if what == "poster":
        slots.append(on_wall("poster", wall, y, 1.5, (0.5, 0.7), everywhere=bool(rng.random() < 0.3)))
    elif what == "board":
        slots.append(on_wall("board", wall, y, 1.5, (1.0, 0.75)))
    elif what == "plant":
        slots.append(Slot("plant", vector(wall - sign * 0.2, y, 0)))
    elif what == "level":
        slots.append(on_wall("level", wall, y - 0.5, 1.6, (0.36, 0.46)))
        slots.append(on_wall("direction", wall, y + 0.2, 1.75, (0.8, 0.3)))
    elif what == "cupboard":
        wide, tall, deep = 0.9, 1.1, 0.36
        face = materials.plaster(rng, (round(tall * 60), round(wide * 60)), (176, 178, 180))
        face[:, ::27], face[::22] = (110, 112, 114), (110, 112, 114)
        xs = sorted((wall, wall - sign * deep))
        place.surfaces += box((xs[0], xs[1]), (y - wide / 2, y + wide / 2), (0, tall), face, label("bench"))
        slots.append(on_wall("poster", wall, y, 1.6, (0.42, 0.6)))
    else:
        xs = sorted((wall - sign * 0.02, wall - sign * 0.15))
        red, black = metal((196, 34, 32)), metal((44, 44, 46))
        place.surfaces += box((xs[0], xs[1]), (y - 0.065, y + 0.065), (0.75, 1.17), red, SIGN)
        place.surfaces += box((xs[0], xs[1]), (y - 0.03, y + 0.03), (1.17, 1.26), black, SIGN)
        mark = on_wall("stripe", wall, y, 1.75, (0.16, 0.16))
        place.surfaces.append(Surface(mark.origin, mark.across, mark.down, _flame(), SIGN))


def _flame() -> Pixels:
    """The mark over a fire extinguisher."""
    mark = np.full((48, 48, 3), (196, 34, 32), np.uint8)
    mark[3:5, 3:45], mark[43:45, 3:45], mark[3:45, 3:5], mark[3:45, 43:45] = 244, 244, 244, 244
    mark[18:40, 17:27], mark[12:18, 19:25], mark[14:17, 25:34] = 244, 244, 244
    return mark


def _leaf(wood: Pixels) -> Pixels:
    """A door in its frame, with a handle."""
    leaf = np.repeat(np.repeat(wood // 3, 2, axis=0), 2, axis=1) + (wood.mean(axis=(0, 1)) * 0.66).astype(np.uint8)
    frame = (leaf.mean(axis=(0, 1)) * 0.6).astype(np.uint8)
    leaf[:8], leaf[:, :7], leaf[:, -7:] = frame, frame, frame
    rows, columns = leaf.shape[:2]
    leaf[rows // 2 : rows // 2 + 5, 12:28] = (196, 196, 190)
    leaf[rows // 2 - 8 : rows // 2 + 22, 14:20] = (170, 170, 166)
    leaf[-30:-2, 8 : columns - 8] = (164, 164, 162)
    return np.ascontiguousarray(leaf)


def _end(
    place: Place,
    rng: np.random.Generator,
    half: float,
    height: float,
    length: float,
    paint: Colour,
    accent: Colour,
    dado: float,
) -> None:
    texture, labels, glow = plain_wall(rng, 2 * half, height, paint, accent, dado)
    put_window(rng, texture, labels, glow, max(0.15, half - 0.8), height)
    place.surfaces.append(
        Surface(vector(-half, length, height), vector(2 * half, 0, 0), vector(0, 0, -height), texture, labels, glow)
    )
