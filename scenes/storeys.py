"""One floor of a building: a shell that all floors share, and the small things in which they differ."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from scenes import notices
from scenes.geometry import Place, Sprite, Surface, Vector, Viewpoint, box, vector
from scenes.materials import Colour
from scenes.plants import GREENS, clump
from scenes.words import label

SlotKind = Literal[
    "number", "level", "direction", "poster", "board", "note", "plant", "company", "directory", "lift", "stripe"
]
SIGN, TREE, BENCH = label("sign"), label("tree"), label("bench")
PROUD = 0.012
"""Metres by which a notice stands out from its wall."""


@dataclass(frozen=True, eq=False)
class Slot:
    """Where floors may differ.

    Parameters
    ----------
    kind : str
        What is there: a poster, the number of a door, a plant.
    origin : float64 of shape (3,)
        Upper left corner of the notice; of a plant, where it stands.
    across, down : float64 of shape (3,)
        Its sides, as those of a `Surface`.
    number : int
        Of a door, counted on its floor.
    everywhere : bool
        Whether all floors show the same: the poster of the house, the rules in case of fire.
    """

    kind: SlotKind
    origin: Vector
    across: Vector = field(default_factory=lambda: vector(0, 0, 0))
    down: Vector = field(default_factory=lambda: vector(0, 0, 0))
    number: int = 0
    everywhere: bool = False

    @property
    def size(self) -> tuple[float, float]:
        """(width, height) in metres."""
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))


@dataclass(frozen=True, eq=False)
class Storey:
    """What all floors of a building share.

    Parameters
    ----------
    place : Place
        Without what differs.
    slots : list of Slot
    spots : list of Viewpoint
        Where one stands, a step apart, in the place's coordinates.
    accent, ground : Colour
        Of the signs, and of what they are mounted on.
    doors : int
        Numbered doors on a floor.
    """

    place: Place
    slots: list[Slot]
    spots: list[Viewpoint]
    accent: Colour
    ground: Colour
    doors: int = 0


def on_wall(
    kind: SlotKind, x: float, y: float, z: float, size: tuple[float, float], *, everywhere: bool = False
) -> Slot:
    """A slot on a side wall at `x` (negative: the left one), its middle at (y, z), its sides in metres."""
    sign = -1.0 if x < 0 else 1.0
    width, height = size
    origin = vector(x - sign * PROUD, y + sign * width / 2, z + height / 2)
    return Slot(kind, origin, vector(0, -sign * width, 0), vector(0, 0, -height), everywhere=everywhere)


def facing(kind: SlotKind, x: float, y: float, z: float, size: tuple[float, float]) -> Slot:
    """A slot on a wall across the way at `y`, its middle at (x, z), its sides in metres."""
    width, height = size
    return Slot(kind, vector(x - width / 2, y - PROUD, z + height / 2), vector(width, 0, 0), vector(0, 0, -height))


def jutting(kind: SlotKind, x: float, y: float, z: float, size: tuple[float, float], number: int) -> Slot:
    """A slot that juts out from a side wall at `x`, to be read from along the wall; its middle is at (y, z)."""
    slot = facing(kind, x - (0.03 + size[0] / 2) * (-1.0 if x < 0 else 1.0), y, z, size)
    return replace(slot, number=number)


def floor_of(storey: Storey, seed: int, floor: int) -> Place:
    """The place that one floor is: the shell with this floor's notices, numbers and plants.

    Parameters
    ----------
    storey : Storey
    seed : int
        Of the building.
    floor : int
        From 1.
    """
    place = storey.place
    surfaces, sprites = list(place.surfaces), list(place.sprites)
    for i, slot in enumerate(storey.slots):
        rng = np.random.default_rng([seed, i, 0 if slot.everywhere else floor])
        if slot.kind == "plant":
            parts, leaves = _plant(rng, slot)
            surfaces, sprites = surfaces + parts, sprites + leaves
        else:
            surfaces += _notice(rng, slot, storey, seed, floor)
    return replace(place, surfaces=surfaces, sprites=sprites)


def _notice(rng: np.random.Generator, slot: Slot, storey: Storey, seed: int, floor: int) -> list[Surface]:
    glow = None
    match slot.kind:
        case "number":
            texture = notices.number_plate(100 * floor + slot.number, storey.accent)
        case "level":
            texture = notices.level_sign(floor, storey.accent)
        case "direction":
            texture = notices.direction_sign(floor, storey.doors, storey.accent, band(seed, floor))
        case "poster":
            texture = notices.poster(rng, *slot.size)
        case "board":
            texture = notices.notice_board(rng, *slot.size, (178, 140, 92))
        case "note":
            if rng.random() < 0.5:
                return []
            texture = notices.taped_note(rng)
        case "company":
            texture = notices.company_sign(rng, firms(seed, floor)[floor - 1], *slot.size, storey.ground)
        case "directory":
            texture = notices.directory(firms(seed, floor), floor, *slot.size)
        case "lift":
            texture, glow = notices.lift_display(floor)
        case _:
            texture = notices.sheet(*slot.size, band(seed, floor))
    return [Surface(slot.origin, slot.across, slot.down, texture, SIGN, glow)]


def band(seed: int, floor: int) -> Colour:
    """The colour of a floor's stripe."""
    order = np.random.default_rng([seed, 7]).permutation(len(notices.HUES))
    return notices.HUES[order[floor % len(order)]]


def firms(seed: int, floor: int) -> list[str]:
    """The firm of each floor from the first up, up to the sixth or to `floor`."""
    order = np.random.default_rng([seed, 8]).permutation(len(notices.FIRMS))
    return [notices.FIRMS[order[i % len(order)]] for i in range(max(6, floor))]


def _plant(rng: np.random.Generator, slot: Slot) -> tuple[list[Surface], list[Sprite]]:
    """A plant in a pot, or none."""
    if rng.random() < 0.4:
        return [], []
    x, y, _ = slot.origin
    pot = notices.sheet(0.1, 0.1, ((150, 92, 66), (84, 86, 90), (214, 210, 202))[rng.integers(3)])
    parts = box((x - 0.12, x + 0.12), (y - 0.12, y + 0.12), (0, 0.3), pot, BENCH)
    leaves = [clump(rng, GREENS[rng.integers(len(GREENS))], needles=bool(rng.random() < 0.3)) for _ in range(2)]
    tall = float(rng.uniform(0.3, 0.6))
    sprites = []
    for i in range(14):
        up = i / 13
        dx, dy = rng.normal(0, 0.07, 2)
        centre = vector(x + dx, y + dy, 0.38 + up * tall)
        size = 0.27 * float(rng.uniform(0.7, 1.1))
        sprites.append(Sprite(centre, size, size, leaves[rng.integers(2)], TREE, 0.65 + 0.35 * up))
    return parts, sprites
