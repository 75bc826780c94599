"""Floors of one building that look alike: who tells them apart must read a sign, a number, a poster.

for floor, spot, image in building(seed=1, floors=4, spots=6).enrolments():
    ...

``python -m scenes DIR`` writes a building as a folder of images with a table of right answers.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from scenes.geometry import Pixels, Place, Viewpoint
from scenes.landing import landing
from scenes.lobby import lobby
from scenes.scene import Lighting, digest, draw
from scenes.storeys import Storey, floor_of

BuildingKind = Literal["corridor", "lobby"]
KINDS = {"corridor": landing, "lobby": lobby}
LIGHTS: tuple[Lighting, ...] = ("noon", "overcast", "dusk")
"""Lightings of queries; at night nobody could read the numbers."""


class Shot(NamedTuple):
    """An image of a floor, taken at a spot; both are counted from 1, and `image` is uint8 RGB (height, width, 3)."""

    floor: int
    spot: int
    image: Pixels


@dataclass(frozen=True)
class Building:
    """A building whose floors have the same walls, doors, lamps and furniture.

    Its floors differ in what hangs on the walls and stands in the corners: numbers, level signs, posters, notices,
    plants, the colour of a stripe. One more floor, `unknown_floor`, is never enrolled.

    Parameters
    ----------
    seed : int
        Decides what the floors share and what each has of its own.
    floors : int
        Floors that are enrolled, from 1.
    spots : int
        Spots on each floor, a step apart, from 1.
    kind : {"corridor", "lobby"}
    size : (int, int)
        (width, height) of the images.
    """

    seed: int
    floors: int = 4
    spots: int = 6
    kind: BuildingKind = "corridor"
    size: tuple[int, int] = (640, 480)

    def __post_init__(self) -> None:
        if self.kind not in KINDS or self.floors < 1 or self.spots < 1:
            raise ValueError(f"no building {self!r}; kinds are {sorted(KINDS)}, floors and spots at least 1")

    @property
    def unknown_floor(self) -> int:
        """The floor that is never enrolled."""
        return self.floors + 1

    def view(
        self,
        floor: int,
        spot: int,
        moved: Viewpoint | None = None,
        light: Lighting = "noon",
        things: tuple[str, ...] = (),
    ) -> tuple[Pixels, Pixels]:
        """Draw what is seen from a spot.

        Parameters
        ----------
        floor, spot : int
        moved : Viewpoint, optional
            Relative to the spot.
        light : {"noon", "overcast", "dusk", "night"}
        things : tuple of {"person"}
            Passing things that stand in front.

        Returns
        -------
        pixels : uint8 of shape (height, width, 3)
            RGB.
        labels : uint8 of shape (height, width)
            Index into `scenes.words.LABELS` for each pixel.
        """
        if not (1 <= floor <= self.unknown_floor and 1 <= spot <= self.spots):
            raise ValueError(
                f"no floor {floor}, spot {spot}; there are {self.unknown_floor} floors, {self.spots} spots"
            )
        at = _storey(self.seed, self.kind, self.spots).spots[spot - 1].then(moved or Viewpoint())
        place = _floor(self.seed, self.kind, self.spots, floor)
        moment = np.random.default_rng(digest(repr((self.seed, self.kind, floor, spot, at, light, things))))
        return draw(place, at, light, self.size, moment, things)

    def enrolments(self) -> Iterator[Shot]:
        """Each spot of each enrolled floor: the same viewpoint on all floors, so that it gives none of them away."""
        for floor in range(1, self.floors + 1):
            for spot in range(1, self.spots + 1):
                yield Shot(floor, spot, self.view(floor, spot)[0])

    def queries(self, count: int = 1) -> Iterator[Shot]:
        """`count` images of each spot of each enrolled floor, moved, turned, in other light."""
        for floor in range(1, self.floors + 1):
            yield from self._queries(floor, count)

    def unknown(self, count: int = 1) -> Iterator[Shot]:
        """As `queries`, of the floor that is never enrolled."""
        yield from self._queries(self.unknown_floor, count)

    def _queries(self, floor: int, count: int) -> Iterator[Shot]:
        for spot in range(1, self.spots + 1):
            for i in range(count):
                rng = np.random.default_rng([self.seed, floor, spot, i])
                dx, up, turn = rng.uniform(-0.25, 0.25), rng.uniform(-0.1, 0.1), rng.uniform(-5, 5)
                moved = Viewpoint(float(dx), float(rng.uniform(-0.4, 0.4)), float(up), float(turn))
                things = ("person",) if rng.random() < 0.15 else ()
                yield Shot(floor, spot, self.view(floor, spot, moved, LIGHTS[rng.integers(3)], things)[0])


def building(
    seed: int,
    floors: int = 4,
    spots: int = 6,
    kind: BuildingKind = "corridor",
    size: tuple[int, int] = (640, 480),
) -> Building:
    """A building of look-alike floors; parameters as those of `Building`."""
    return Building(seed, floors, spots, kind, size)


@functools.lru_cache(maxsize=4)
def _storey(seed: int, kind: BuildingKind, spots: int) -> Storey:
    return KINDS[kind](np.random.default_rng([seed, sorted(KINDS).index(kind)]), spots)


@functools.lru_cache(maxsize=16)
def _floor(seed: int, kind: BuildingKind, spots: int, floor: int) -> Place:
    return floor_of(_storey(seed, kind, spots), seed, floor)
