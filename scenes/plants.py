"""Trees and bushes: stems and clumps of leaves as sprites placed in space, so that parallax is right."""

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Pixels, Place, Sprite, vector
from scenes.materials import Colour
from scenes.words import label

GREENS: tuple[Colour, ...] = ((74, 104, 44), (92, 118, 52), (58, 88, 50), (112, 124, 58), (50, 78, 40), (128, 116, 54))
TREE = label("tree")


def clump(rng: np.random.Generator, colour: Colour, *, needles: bool = False) -> Pixels:
    """A clump of leaves, RGBA 112 x 112: dark inside and below, light leaves on top."""
    size = 112
    image = np.zeros((size, size, 4), np.uint8)
    layers = 330
    for i in range(layers):
        angle, distance = rng.uniform(0, 2 * np.pi), np.sqrt(rng.uniform()) * 44
        x, y = size / 2 + distance * np.cos(angle), size / 2 + distance * 0.9 * np.sin(angle)
        height = 1 - y / size
        light = (0.42 + 0.55 * i / layers) * (0.62 + 0.75 * height) * rng.uniform(0.8, 1.2)
        leaf = tuple(int(min(c * light + rng.normal(0, 5), 250)) if c * light > 5 else 5 for c in colour)
        axes = (int(rng.integers(6, 11)), 1) if needles else (int(rng.integers(3, 7)), int(rng.integers(2, 4)))
        turn = float(rng.uniform(20, 70)) if needles else float(rng.uniform(0, 180))
        cv2.ellipse(image, (int(x), int(y)), axes, turn, 0, 360, (*leaf, 255), -1)
    return image


def stem(rng: np.random.Generator, colour: Colour = (92, 76, 60)) -> Pixels:
    """A stem with a flaring foot and a fork of boughs above, RGBA 256 x 128."""
    rows, columns = 256, 128
    texture = np.zeros((rows, columns, 4), np.uint8)
    texture[..., :3] = materials.bark(rng, (rows, columns), colour)
    mask = np.zeros((rows, columns), np.uint8)
    outline = np.array([[50, 256], [56, 225], [58, 110], [70, 110], [72, 225], [78, 256]], np.int32)
    cv2.fillPoly(mask, [outline], 255)
    for _ in range(9):
        x, y, angle, thick = 64.0, float(rng.uniform(95, 150)), float(rng.uniform(-1.0, 1.0)), 9.0
        for _ in range(9):
            x2, y2 = x + 13 * np.sin(angle), y - 13 * np.cos(angle)
            cv2.line(mask, (int(x), int(y)), (int(x2), int(y2)), 255, max(1, int(thick)), cv2.LINE_AA)
            x, y, angle, thick = x2, y2, angle + float(rng.normal(0, 0.22)), thick * 0.82
    texture[..., 3] = mask
    # `materials.bark` shades the whole width; shade the stem instead.
    shade = 0.6 + 0.45 * np.sin(np.clip((np.arange(columns) - 44) / 40, 0, 1) * np.pi)
    texture[..., :3] = np.clip(texture[..., :3] * shade[None, :, None], 0, 255).astype(np.uint8)
    return texture


class Nursery:
    """The kinds of trees of one place; all trees of a kind share its clumps and stem."""

    def __init__(self, rng: np.random.Generator, kinds: int = 2) -> None:
        self._kinds = []
        for _ in range(kinds):
            colour = GREENS[rng.integers(len(GREENS))]
            needles = bool(rng.random() < 0.25)
            clumps = [clump(rng, colour, needles=needles) for _ in range(3)]
            self._kinds.append((needles, clumps, stem(rng)))

    def tree(
        self, place: Place, rng: np.random.Generator, x: float, y: float, height: float, *, clumps: int = 46
    ) -> None:
        """Add a tree at (x, y), metres."""
        needles, leaves, wood = self._kinds[rng.integers(len(self._kinds))]
        crown_from = 0.16 * height if needles else float(rng.uniform(0.26, 0.36)) * height
        reach = (0.2 if needles else float(rng.uniform(0.26, 0.34))) * height
        trunk = max(1.2, height * 0.72)
        place.sprites.append(Sprite(vector(x, y, trunk / 2), trunk / 2, trunk, wood, TREE, 0.85))
        middle = (crown_from + height) / 2
        half = (height - crown_from) / 2
        for _ in range(clumps):
            up = float(rng.uniform(-1, 1))
            wide = reach * (1 - (up + 1) / 2 * 0.92) if needles else reach * np.sqrt(max(0.0, 1 - up * up))
            angle, share = float(rng.uniform(0, 2 * np.pi)), float(np.sqrt(rng.uniform(0.25, 1)))
            size = reach * float(rng.uniform(0.62, 0.95)) * (0.75 if needles else 1.0)
            centre = vector(
                x + share * wide * np.cos(angle), y + share * wide * np.sin(angle), middle + up * half * 0.86
            )
            # Clumps towards the top and the left get more light than those inside the crown.
            brightness = 0.72 + 0.26 * up - 0.1 * np.cos(angle) + float(rng.normal(0, 0.05))
            texture = leaves[rng.integers(len(leaves))]
            place.sprites.append(Sprite(centre, size, size, texture, TREE, float(np.clip(brightness, 0.4, 1.15))))
        place.shadows.append(_disc(x, y, reach, height))

    def bush(self, place: Place, rng: np.random.Generator, x: float, y: float, size: float) -> None:
        """Add a bush at (x, y), metres."""
        _, leaves, _ = self._kinds[rng.integers(len(self._kinds))]
        for _ in range(9):
            dx, dy, dz = rng.normal(0, 0.3, 3) * size
            centre = vector(x + dx, y + dy, max(0.3 * size, size * 0.45 + dz * 0.5))
            place.sprites.append(
                Sprite(
                    centre,
                    size * 0.75,
                    size * 0.75,
                    leaves[rng.integers(len(leaves))],
                    TREE,
                    0.7 + 0.2 * float(dz > 0),
                )
            )
        place.shadows.append(_disc(x, y, size * 0.6, size))


def _disc(x: float, y: float, radius: float, height: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Footprint of a round object, with the height from which its shadow is cast."""
    angle = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(14, height * 0.75)], axis=1)
