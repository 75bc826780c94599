"""Parks: lawns, a winding path, many trees, benches, a pond or a pavilion, houses behind the trees."""

from collections.abc import Callable

import cv2
import numpy as np

from scenes import furniture, materials
from scenes.geometry import Pixels, Place, Viewpoint
from scenes.houses import house
from scenes.plants import Nursery
from scenes.words import label

PER_METRE = 22
BEHIND, LENGTH, HALF = -6.0, 64.0, 34.0


def park(rng: np.random.Generator) -> Place:
    """A random park seen from its path."""
    place = Place(start=Viewpoint(turn=float(rng.uniform(-8, 8)), tilt=float(rng.uniform(0, 3))))
    nursery = Nursery(rng, kinds=4)
    bend, width = float(rng.uniform(-9, 9)), float(rng.uniform(1.6, 3.4))
    wave = float(rng.uniform(14, 30))

    def middle(y: float) -> float:
        return bend * float(np.sin(max(y, 0) / wave))

    pond = _ground(place, rng, middle, width)
    _houses_behind(place, rng)
    for _ in range(int(rng.integers(15, 25))):
        x, y = float(rng.uniform(-24, 24)), float(rng.uniform(4, 44))
        if abs(x - middle(y)) < width / 2 + 1.6 or (pond is not None and np.hypot(x - pond[0], y - pond[1]) < pond[2]):
            continue
        nursery.tree(place, rng, x, y, float(rng.uniform(5, 13)), clumps=56 if y < 14 else 34)
    for x in np.arange(-33, 34, 4.0):
        nursery.tree(
            place, rng, float(x + rng.normal(0, 1)), 47 + float(rng.normal(0, 2)), float(rng.uniform(6, 12)), clumps=22
        )
    for _ in range(int(rng.integers(4, 12))):
        x, y = float(rng.uniform(-14, 14)), float(rng.uniform(5, 30))
        if abs(x - middle(y)) > width / 2 + 0.8:
            nursery.bush(place, rng, x, y, float(rng.uniform(0.8, 1.7)))
    _along_the_path(place, rng, middle, width)
    if rng.random() < 0.5:
        sign = int(rng.choice([-1, 1]))
        x = sign * float(rng.uniform(6, 11))
        furniture.fence(place, rng, (x, BEHIND), (x + sign * 4, 40), float(rng.uniform(0.7, 1.2)))
    if rng.random() < 0.45:
        _pavilion(place, rng, float(rng.choice([-1, 1])) * float(rng.uniform(5, 11)), float(rng.uniform(14, 24)))
    place.stands = {
        "bus": (middle(14) + 3.5, 13.0, 82.0),
        "car": (middle(8) + 0.3, 8.5, 10.0),
        "person": (middle(5) + float(rng.uniform(-0.9, 0.9)), 5.0, 0.0),
    }
    return place


def _along_the_path(place: Place, rng: np.random.Generator, middle: Callable[[float], float], width: float) -> None:
    colour = ((40, 50, 46), (96, 98, 100), (70, 54, 44))[rng.integers(3)]
    style, height = int(rng.integers(2)), float(rng.uniform(3.2, 4.6))
    for i, y in enumerate(np.arange(float(rng.uniform(6, 11)), 44, float(rng.uniform(10, 15)))):
        side = 1 if i % 2 else -1
        x = middle(float(y)) + side * (width / 2 + 0.5)
        furniture.lamp_post(place, x, float(y), height, -side * 0.9, colour, style=style)
    for y in rng.uniform(6, 28, int(rng.integers(2, 5))):
        side = int(rng.choice([-1, 1]))
        x = middle(float(y)) + side * (width / 2 + 1.0)
        furniture.bench(place, rng, x, float(y), side * 90 + float(rng.normal(0, 6)))
        if rng.random() < 0.6:
            furniture.bin_(place, x, float(y) + 1.6, (46, 92, 60))
    if rng.random() < 0.5:
        furniture.sign(place, rng, middle(9) - width / 2 - 0.7, float(rng.uniform(7, 12)))


def _houses_behind(place: Place, rng: np.random.Generator) -> None:
    x = -52.0
    y = float(rng.uniform(54, 60))
    while x < 52:
        width = float(rng.uniform(9, 16))
        if rng.random() < 0.75:
            house(place, rng, (x, y), (1, 0), width, float(rng.uniform(8, 24)))
        x += width + float(rng.uniform(0, 4))


def _pavilion(place: Place, rng: np.random.Generator, x: float, y: float) -> None:
    """A small kiosk."""
    house(place, rng, (x - 2.4, y), (1, 0), 4.8, float(rng.uniform(3.6, 4.4)), depth=4.5)


def _ground(
    place: Place, rng: np.random.Generator, middle: Callable[[float], float], width: float
) -> tuple[float, float, float] | None:
    """Draw the ground texture of lawn, path and pond; returns the pond's (x, y, radius) in metres, if there is one."""
    place.ground = (-HALF, HALF, BEHIND, LENGTH)
    rows, columns = round((LENGTH - BEHIND) * PER_METRE), round(2 * HALF * PER_METRE)
    lawn = ((104, 122, 70), (116, 124, 76), (92, 110, 66), (132, 128, 84))[rng.integers(4)]
    texture = materials.grass(rng, (rows, columns), lawn)
    labels = np.full((rows, columns), label("grass"), np.uint8)
    mask = np.zeros((rows, columns), np.uint8)
    ys = np.arange(BEHIND, LENGTH, 0.5)
    xs = np.array([middle(float(y)) for y in ys])
    line = np.stack([(xs + HALF) * PER_METRE, (LENGTH - ys) * PER_METRE], axis=1).astype(np.int32)
    cv2.polylines(mask, [line], False, 255, round(width * PER_METRE), cv2.LINE_AA)
    if rng.random() < 0.5:  # a second path crosses
        at = float(rng.uniform(9, 24))
        ends = [[0, int((LENGTH - at - rng.uniform(-5, 5)) * PER_METRE)], [columns, int((LENGTH - at) * PER_METRE)]]
        cv2.polylines(mask, [np.array(ends, np.int32)], False, 255, round(width * 0.8 * PER_METRE), cv2.LINE_AA)
    gravel = ((184, 168, 138), (160, 152, 142), (172, 140, 110))[rng.integers(3)]
    if rng.random() < 0.4:
        path = materials.paving(rng, (rows, columns), gravel, (8, 16))
    else:
        light = 1 + 0.07 * materials.noise(rng, (rows, columns), 60) + 0.11 * rng.standard_normal((rows, columns))
        path = materials.tinted(gravel, light.astype(np.float32))
    edge = cv2.dilate(mask, np.ones((5, 5), np.uint8)) > mask
    texture[edge] = (texture[edge] * 0.66).astype(np.uint8)
    texture[mask > 127] = path[mask > 127]
    labels[mask > 127] = label("path")
    pond = None
    if rng.random() < 0.4:
        radius = float(rng.uniform(4, 8))
        side = float(rng.choice([-1, 1]))
        pond = (side * (radius + 4.5 + abs(middle(18))), float(rng.uniform(15, 22)), radius)
        centre = (round((pond[0] + HALF) * PER_METRE), round((LENGTH - pond[1]) * PER_METRE))
        axes = (round(radius * PER_METRE), round(radius * 0.75 * PER_METRE))
        water = np.zeros((rows, columns), np.uint8)
        cv2.ellipse(texture, centre, (axes[0] + 9, axes[1] + 9), 0, 0, 360, (118, 112, 92), -1, cv2.LINE_AA)
        cv2.ellipse(water, centre, axes, 0, 0, 360, 255, -1)
        ripples = 1 + 0.12 * materials.noise(rng, (rows // 4, columns), 12, 3)
        ripples = cv2.resize(ripples, (columns, rows))
        texture[water > 0] = materials.tinted((104, 128, 140), ripples)[water > 0]
        labels[water > 0] = label("water")
    _flower_beds(rng, texture, middle, width)
    place.ground_texture, place.ground_labels = texture, labels
    return pond


def _flower_beds(rng: np.random.Generator, texture: Pixels, middle: Callable[[float], float], width: float) -> None:
    """Dots of colour beside the path."""
    for _ in range(int(rng.integers(0, 4))):
        y = float(rng.uniform(5, 24))
        x = middle(y) + float(rng.choice([-1, 1])) * (width / 2 + float(rng.uniform(1.5, 4)))
        colour = ((206, 60, 70), (226, 190, 60), (190, 120, 200), (240, 236, 230))[rng.integers(4)]
        for _ in range(130):
            dx, dy = rng.normal(0, 0.6, 2)
            at = (round((x + dx + HALF) * PER_METRE), round((LENGTH - y - dy) * PER_METRE))
            cv2.circle(texture, at, int(rng.integers(1, 3)), tuple(int(c * rng.uniform(0.7, 1)) for c in colour), -1)
