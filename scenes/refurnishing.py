"""Places that are refurnished: furniture that stands in one image of a place and not in another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from scenes import materials
from scenes.furniture import metal
from scenes.geometry import Pixels, Place, Sprite, Surface, Viewpoint, box, standing, vector
from scenes.plants import clump
from scenes.scene import Scene, digest, draw, place_of

Furniture = Literal["cupboard", "chair", "table", "plant", "bin", "board"]
FURNITURE: tuple[Furniture, ...] = ("cupboard", "chair", "table", "plant", "bin", "board")
FIRST_MARK = 100
"""Label of the first piece: each has one of its own, beyond those of `scenes.words.LABELS`."""

PAINTS = ((172, 60, 44), (222, 178, 52), (58, 96, 150), (152, 112, 74), (228, 226, 220), (58, 120, 82), (70, 72, 78))


@dataclass(frozen=True)
class Piece:
    """A piece of furniture, and where it stands.

    Parameters
    ----------
    kind : {"cupboard", "chair", "table", "plant", "bin", "board"}
    across, ahead : float
        Metres to the right of and ahead of the place's own viewpoint.
    seed : int
        Decides its colour and size.
    """

    kind: Furniture
    across: float
    ahead: float
    seed: int = 0

    def moved(self, across: float = 0.0, ahead: float = 0.0) -> "Piece":
        """The same piece, so many metres to the right and further away."""
        return replace(self, across=self.across + across, ahead=self.ahead + ahead)


def furnished(scene: Scene, pieces: Sequence[Piece]) -> tuple[Pixels, list[Pixels]]:
    """Draw a scene with furniture.

    Returns
    -------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    masks : list of uint8 of shape (height, width)
        1 where a piece is seen, one mask for each.
    """
    place = place_of(scene)
    at = place.start.then(scene.viewpoint)
    moment = digest(repr((scene, tuple(pieces))))

    full = replace(place, surfaces=list(place.surfaces), sprites=list(place.sprites))
    for number, piece in enumerate(pieces):
        _put(full, piece, FIRST_MARK + number)
    pixels, labels = draw(full, at, scene.light, scene.size, np.random.default_rng(moment), scene.things)
    return pixels, [np.asarray(labels == FIRST_MARK + number, np.uint8) for number in range(len(pieces))]


def _put(place: Place, piece: Piece, number: int) -> None:
    """Stand a piece on the ground of a place; `number` is its label."""
    rng = np.random.default_rng([piece.seed, FURNITURE.index(piece.kind)])
    surfaces, sprites = PIECES[piece.kind](rng, number)
    stand = Viewpoint(place.start.dx, place.start.ahead, 0.0, place.start.turn).then(
        Viewpoint(piece.across, piece.ahead)
    )
    if place.indoors and place.ground is not None:
        most = place.ground[1] - 0.35  # within the walls
        stand = replace(stand, dx=float(np.clip(stand.dx, -most, most)))
    place.surfaces += standing(surfaces, stand.dx, stand.ahead, place.start.turn if not place.indoors else 0.0)
    place.sprites += [replace(one, centre=one.centre + vector(stand.dx, stand.ahead, 0)) for one in sprites]


Parts = tuple[list[Surface], list[Sprite]]


def _cupboard(rng: np.random.Generator, number: int) -> Parts:
    wide, tall = float(rng.uniform(0.8, 1.1)), float(rng.uniform(1.1, 1.9))
    colour = PAINTS[rng.integers(len(PAINTS))]
    face = materials.plaster(rng, (round(tall * 60), round(wide * 60)), colour)
    dark = (np.array(colour) * 0.45).astype(np.uint8)
    face[:, face.shape[1] // 2 - 1 : face.shape[1] // 2 + 1] = dark
    for row in range(0, face.shape[0], max(12, face.shape[0] // 4)):
        face[row : row + 2] = dark
    face[face.shape[0] // 2 : face.shape[0] // 2 + 8, face.shape[1] // 2 + 4 : face.shape[1] // 2 + 8] = 210
    return box((-wide / 2, wide / 2), (-0.22, 0.22), (0, tall), face, number), []


def _legs(width: float, depth: float, top: float, texture: Pixels, number: int) -> list[Surface]:
    parts: list[Surface] = []
    for x in (-width / 2, width / 2 - 0.05):
        for y in (-depth / 2, depth / 2 - 0.05):
            parts += box((x, x + 0.05), (y, y + 0.05), (0, top), texture, number)
    return parts


def _chair(rng: np.random.Generator, number: int) -> Parts:
    cover = materials.plaster(rng, (40, 40), PAINTS[rng.integers(len(PAINTS))])
    frame = metal((60, 60, 62))
    parts = _legs(0.5, 0.5, 0.44, frame, number)
    parts += box((-0.27, 0.27), (-0.27, 0.27), (0.42, 0.52), cover, number)
    back = (0.21, 0.27) if rng.random() < 0.5 else (-0.27, -0.21)
    return parts + box((-0.27, 0.27), back, (0.5, 1.0), cover, number), []


def _table(rng: np.random.Generator, number: int) -> Parts:
    wide = float(rng.uniform(0.9, 1.4))
    top = materials.bark(rng, (40, 80), ((150, 112, 74), (222, 220, 214), (96, 72, 56))[rng.integers(3)])
    parts = _legs(wide, 0.7, 0.72, metal((70, 70, 72)), number)
    return parts + box((-wide / 2, wide / 2), (-0.4, 0.4), (0.7, 0.78), top, number), []


def _plant(rng: np.random.Generator, number: int) -> Parts:
    pot = materials.plaster(rng, (40, 40), PAINTS[rng.integers(len(PAINTS))])
    tall = float(rng.uniform(0.35, 0.6))
    leaves = clump(rng, ((70, 120, 60), (96, 140, 70), (60, 100, 74))[rng.integers(3)])
    crown = float(rng.uniform(0.7, 1.1))
    sprites = [
        Sprite(vector(dx, 0, tall + crown * h), crown, crown, leaves, number)
        for dx, h in ((-0.12, 0.42), (0.14, 0.5), (0.0, 0.85))
    ]
    return box((-0.2, 0.2), (-0.2, 0.2), (0, tall), pot, number), sprites


def _bin(rng: np.random.Generator, number: int) -> Parts:
    tall = float(rng.uniform(0.7, 1.05))
    body = materials.plaster(rng, (60, 40), PAINTS[rng.integers(len(PAINTS))])
    lid = np.full((16, 16, 3), 40, np.uint8)
    parts = box((-0.26, 0.26), (-0.26, 0.26), (0, tall), body, number)
    return parts + box((-0.29, 0.29), (-0.29, 0.29), (tall, tall + 0.1), lid, number), []


def _board(rng: np.random.Generator, number: int) -> Parts:
    face = np.full((90, 60, 3), 236, np.uint8)
    face[:24] = PAINTS[rng.integers(len(PAINTS))]
    for row in range(34, 84, 9):
        face[row : row + 3, 8 : int(rng.integers(30, 52))] = 60
    return box((-0.35, 0.35), (-0.04, 0.04), (0.05, 1.15), face, number), []


PIECES = {"cupboard": _cupboard, "chair": _chair, "table": _table, "plant": _plant, "bin": _bin, "board": _board}
