"""Streets: two rows of houses, pavements, a road with its markings, trees, lamps and signs."""

from collections.abc import Callable

import cv2
import numpy as np

from scenes import furniture, materials
from scenes.geometry import Pixels, Place, Viewpoint
from scenes.houses import house
from scenes.plants import Nursery
from scenes.words import label

PER_METRE = 22
BEHIND, LENGTH = -6.0, 78.0


def street(rng: np.random.Generator) -> Place:
    """A random street that runs away from the camera and may end at a row of houses."""
    road = float(rng.uniform(3.0, 5.0))  # half its width
    pavements = [float(rng.uniform(2.0, 4.4)) for _ in range(2)]
    place = Place(
        start=Viewpoint(
            dx=float(rng.uniform(-0.8, 0.7)) * road, turn=float(rng.uniform(-24, 24)), tilt=float(rng.uniform(1.5, 5))
        )
    )
    nursery = Nursery(rng)
    open_side = int(rng.integers(2)) if rng.random() < 0.35 else None
    end = float(rng.uniform(38, 64)) if rng.random() < 0.7 else None
    _ground(place, rng, road, pavements, open_side, end)
    for side, sign in ((0, -1), (1, 1)):
        edge = sign * (road + pavements[side])
        if side == open_side:
            _green_side(place, rng, nursery, edge, sign)
        else:
            _row_of_houses(place, rng, edge, sign, end or LENGTH - 4)
    if end is not None:
        _closing_row(place, rng, end)
    _along_the_kerb(place, rng, nursery, road, pavements, end or LENGTH)
    inwards = float(np.sign(place.start.dx) or 1.0)
    here = place.start
    facing = np.radians(here.turn)
    for thing, distance, aside in (("bus", 8.6, 0.4), ("car", 7.2, -0.3), ("person", 4.6, 0.7)):
        x = here.dx + distance * np.sin(facing) + aside * inwards
        y = here.ahead + distance * np.cos(facing)
        place.stands[thing] = (float(np.clip(x, -road - 1.5, road + 1.5)), float(y), float(rng.choice([-8, 6])))
    return place


def _row_of_houses(place: Place, rng: np.random.Generator, edge: float, sign: int, length: float) -> None:
    y = BEHIND - float(rng.uniform(0, 5))
    usual = float(rng.uniform(7, 14))
    while y < length:
        width = float(rng.uniform(6, 13))
        height = float(np.clip(usual + rng.normal(0, 2.2), 5.5, 19))
        setback = float(rng.choice([0.0, 0.0, 0.0, 0.6, 1.4]))
        x = edge + sign * setback
        # Seen from the street, a row on the left begins at its near end, one on the right at its far end.
        if sign < 0:
            house(place, rng, (x, y), (0, 1), width, height)
        else:
            house(place, rng, (x, y + width), (0, -1), width, height)
        y += width + (float(rng.uniform(2, 5)) if rng.random() < 0.18 else 0.0)


def _closing_row(place: Place, rng: np.random.Generator, end: float) -> None:
    x = -26.0
    while x < 26:
        width = float(rng.uniform(7, 13))
        house(place, rng, (x, end + 9), (1, 0), width, float(rng.uniform(7, 16)))
        x += width + (2.5 if rng.random() < 0.2 else 0.0)


def _green_side(place: Place, rng: np.random.Generator, nursery: Nursery, edge: float, sign: int) -> None:
    """A side without houses at the street: a fence, a lawn, trees, and houses far behind."""
    furniture.fence(place, rng, (edge + sign * 0.3, BEHIND), (edge + sign * 0.3, 60), float(rng.uniform(1.0, 1.7)))
    for _ in range(11):
        x = edge + sign * float(rng.uniform(2.5, 16))
        nursery.tree(place, rng, x, float(rng.uniform(4, 58)), float(rng.uniform(6, 12)), clumps=40)
    for _ in range(6):
        nursery.bush(place, rng, edge + sign * float(rng.uniform(1.2, 3)), float(rng.uniform(4, 40)), 1.3)
    y = 0.0
    while y < 70:
        width = float(rng.uniform(9, 16))
        x = edge + sign * 24
        if sign < 0:
            house(place, rng, (x, y), (0, 1), width, float(rng.uniform(6, 14)))
        else:
            house(place, rng, (x, y + width), (0, -1), width, float(rng.uniform(6, 14)))
        y += width + float(rng.uniform(0, 7))


def _along_the_kerb(
    place: Place, rng: np.random.Generator, nursery: Nursery, road: float, pavements: list[float], end: float
) -> None:
    post_colour = ((52, 58, 56), (120, 124, 126), (36, 52, 44))[rng.integers(3)]
    style, height = int(rng.integers(2)), float(rng.uniform(4.2, 7.0))
    trees = [rng.random() < 0.55 for _ in range(2)]
    for side, sign in ((0, -1), (1, 1)):
        x = sign * (road + 0.55)
        offset, step = float(rng.uniform(5, 13)), float(rng.uniform(15, 22))
        for y in np.arange(offset, end, step):
            furniture.lamp_post(place, x, float(y), height, -sign * 1.4, post_colour, style=style)
        if trees[side] and pavements[side] > 2.4:
            size = float(rng.uniform(4.5, 8.5))
            for y in np.arange(offset + 5, end, float(rng.uniform(8, 14))):
                nursery.tree(
                    place, rng, x + sign * 0.3, float(y + rng.normal(0, 0.8)), size * float(rng.uniform(0.8, 1.2))
                )
        for _ in range(int(rng.integers(1, 4))):
            furniture.sign(place, rng, x, float(rng.uniform(6, 34)), faces=int(rng.integers(1, 3)))
        if rng.random() < 0.4:
            ys = [float(y) for y in np.arange(rng.uniform(3, 9), rng.uniform(16, 30), 1.9)]
            furniture.bollards(place, sign * (road + 0.3), ys, post_colour)
        if rng.random() < 0.5:
            furniture.bin_(place, x + sign * 0.4, float(rng.uniform(6, 20)), (46, 82, 60))
    if rng.random() < 0.4:
        sign = int(rng.choice([-1, 1]))
        furniture.traffic_light(place, sign * (road + 0.5), float(rng.uniform(14, 26)), -sign * road * 0.9)


def _ground(
    place: Place,
    rng: np.random.Generator,
    road: float,
    pavements: list[float],
    open_side: int | None,
    end: float | None,
) -> None:
    """Draw the ground texture, seen from above: row 0 is the far end."""
    half = 30.0
    place.ground = (-half, half, BEHIND, LENGTH)
    rows, columns = round((LENGTH - BEHIND) * PER_METRE), round(2 * half * PER_METRE)

    def column(x: float) -> int:
        return int(np.clip(round((x + half) * PER_METRE), 0, columns))

    def row(y: float) -> int:
        return int(np.clip(round((LENGTH - y) * PER_METRE), 0, rows))

    slab = ((8, 8), (11, 18), (7, 14), (16, 16))[rng.integers(4)]
    tone = ((150, 146, 140), (168, 160, 150), (136, 128, 122), (158, 136, 118))[rng.integers(4)]
    texture = materials.paving(rng, (rows, columns), tone, slab)
    labels = np.full((rows, columns), label("sidewalk"), np.uint8)
    left, right = column(-road), column(road)
    if rng.random() < 0.2:  # an old street is cobbled
        surface = materials.paving(rng, (rows, right - left), (118, 112, 108), (4, 6))
    else:
        surface = materials.asphalt(rng, (rows, right - left), float(rng.uniform(0.38, 0.52)))
    texture[:, left:right] = surface
    labels[:, left:right] = label("road")
    if end is not None:  # the crossing street
        y0, y1 = row(end + 7), row(end + 1)
        texture[y0:y1] = materials.asphalt(rng, (y1 - y0, columns), 0.38)
        labels[y0:y1] = label("road")
    for x in (left, right):
        texture[:, max(0, x - 4) : x + 4] = (176, 174, 168)  # kerb stones
        texture[:, x - 1 : x + 1] = (88, 88, 90)
    _markings(rng, texture, road, column, row, end)
    if open_side is not None:
        edge = road + pavements[open_side] + 0.2
        area = slice(0, column(-edge)) if open_side == 0 else slice(column(edge), columns)
        texture[:, area] = materials.grass(rng, texture[:, area].shape[:2], (104, 118, 70))
        labels[:, area] = label("grass")
    place.ground_texture, place.ground_labels = texture, labels


def _markings(
    rng: np.random.Generator,
    texture: Pixels,
    road: float,
    column: Callable[[float], int],
    row: Callable[[float], int],
    end: float | None,
) -> None:
    paint = np.array((222, 220, 210))

    def stripe(x0: float, x1: float, y0: float, y1: float) -> None:
        area = texture[row(y1) : row(y0), column(x0) : column(x1)]
        worn = rng.uniform(0.55, 0.95, area.shape[:2])[..., None]
        area[:] = (area * (1 - worn) + paint * worn).astype(np.uint8)

    kind = int(rng.integers(4))
    stop = end if end is not None else LENGTH
    if kind in (0, 1):
        for y in np.arange(BEHIND, stop - 1, 6.0):
            stripe(-0.07, 0.07, float(y), float(y) + 3.0)
    elif kind == 2:
        stripe(-0.2, -0.08, BEHIND, stop)
        stripe(0.08, 0.2, BEHIND, stop)
    if rng.random() < 0.6:
        for sign in (-1, 1):
            a, b = sorted((sign * (road - 0.35), sign * (road - 0.25)))
            stripe(a, b, BEHIND, stop)
    if rng.random() < 0.5:
        y = float(rng.uniform(8, 20))
        for x in np.arange(-road + 0.4, road - 0.5, 1.0):
            stripe(float(x), float(x) + 0.5, y, y + 3.2)
    for _ in range(int(rng.integers(1, 4))):
        at = (column(float(rng.uniform(-road, road) * 0.7)), row(float(rng.uniform(3, 30))))
        cv2.circle(texture, at, 7, (70, 68, 66), -1, cv2.LINE_AA)
        cv2.circle(texture, at, 6, (104, 100, 96), 1, cv2.LINE_AA)
