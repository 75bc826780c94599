"""Drawn places: seen from any viewpoint, in any lighting, with passing things in front or without."""

import functools
import hashlib
from dataclasses import dataclass, field, replace
from typing import Literal

import cv2
import numpy as np

from scenes import things as passing
from scenes.canvas import Canvas
from scenes.corridor import corridor
from scenes.geometry import Camera, Pixels, Place, Sprite, Surface, Viewpoint, vector
from scenes.light import Light, developed, hazed, sky
from scenes.materials import bands
from scenes.park import park
from scenes.street import street
from scenes.words import DYNAMIC, label

Kind = Literal["street", "park", "corridor"]
Lighting = Literal["noon", "overcast", "dusk", "night"]

KINDS = {"street": street, "park": park, "corridor": corridor}
FINER = 2
"""Images are drawn this many times larger and then reduced, which smooths edges."""

_KIND_BY_WORD = {"park": "park", "garden": "park", "meadow": "park", "corridor": "corridor", "hall": "corridor"}


@functools.lru_cache(maxsize=24)
def _built(seed: int, kind: Kind) -> Place:
    """Build a place; cached, because making textures takes longer than drawing an image."""
    return KINDS[kind](np.random.default_rng([seed, sorted(KINDS).index(kind)]))


def place_of(scene: "Scene") -> Place:
    """The fixed part of a scene; shared, so not to be changed."""
    return _built(scene.seed, scene.kind)


@dataclass(frozen=True)
class Scene:
    """A place made from a seed, and how it is seen.

    Parameters
    ----------
    seed : int
        Decides all that is fixed: houses, trees, signs, the place's own viewpoint.
    kind : {"street", "park", "corridor"}
    light : {"noon", "overcast", "dusk", "night"}
    viewpoint : Viewpoint
        Relative to the place's own viewpoint.
    things : tuple of {"bus", "car", "person"}
        Passing things that stand in front.
    size : (int, int)
        (width, height) of the image.
    """

    seed: int
    kind: Kind = "street"
    light: Lighting = "noon"
    viewpoint: Viewpoint = field(default_factory=Viewpoint)
    things: tuple[str, ...] = ()
    size: tuple[int, int] = (640, 480)

    def __post_init__(self) -> None:
        unknown = set(self.things) - set(DYNAMIC)
        if unknown or self.kind not in KINDS:
            raise ValueError(f"no {sorted(unknown) or self.kind!r}; things are {DYNAMIC}, kinds {sorted(KINDS)}")

    def at(self, light: Lighting) -> "Scene":
        """The same scene in another lighting."""
        return replace(self, light=light)

    def behind(self, *things: str) -> "Scene":
        """The same scene with further things in front."""
        return replace(self, things=self.things + things)

    def seen_from(
        self, dx: float = 0.0, ahead: float = 0.0, up: float = 0.0, turn: float = 0.0, tilt: float = 0.0
    ) -> "Scene":
        """The same scene from another viewpoint: metres to the right, ahead and up, degrees to the right and up."""
        return replace(self, viewpoint=self.viewpoint.then(Viewpoint(dx, ahead, up, turn, tilt)))

    def sized(self, width: int, height: int) -> "Scene":
        """The same scene with images of another size, in pixels."""
        return replace(self, size=(width, height))

    @property
    def pixels(self) -> Pixels:
        """The image, uint8 RGB (height, width, 3)."""
        return self.render()[0]

    def render(
        self,
        viewpoint: Viewpoint | None = None,
        light: Lighting | None = None,
        things: tuple[str, ...] | None = None,
        size: tuple[int, int] | None = None,
    ) -> tuple[Pixels, Pixels]:
        """Draw the image and its labels; arguments replace the fields of the scene.

        Returns
        -------
        pixels : uint8 of shape (height, width, 3)
            RGB.
        labels : uint8 of shape (height, width)
            Index into `scenes.words.LABELS` for each pixel.
        """
        varied = replace(
            self,
            viewpoint=viewpoint or self.viewpoint,
            light=light or self.light,
            things=self.things if things is None else things,
            size=size or self.size,
        )
        return varied._drawn()

    def _drawn(self) -> tuple[Pixels, Pixels]:
        place = _built(self.seed, self.kind)
        # Clouds, grain and the paint of vehicles are random per image: they must not identify the place.
        moment = np.random.default_rng(digest(repr(self)))
        return draw(place, place.start.then(self.viewpoint), self.light, self.size, moment, self.things)


def draw(
    place: Place,
    viewpoint: Viewpoint,
    lighting: Lighting,
    size: tuple[int, int],
    moment: np.random.Generator,
    things: tuple[str, ...] = (),
) -> tuple[Pixels, Pixels]:
    """Draw a place.

    Parameters
    ----------
    place : Place
    viewpoint : Viewpoint
        Of the camera, in the place's coordinates.
    lighting : {"noon", "overcast", "dusk", "night"}
    size : (int, int)
        (width, height) of the image.
    moment : numpy.random.Generator
        Makes what belongs to this image alone: clouds, grain, the paint of vehicles.
    things : tuple of {"bus", "car", "person"}
        Passing things that stand in front.

    Returns
    -------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    labels : uint8 of shape (height, width)
        Index into `scenes.words.LABELS` for each pixel.
    """
    fine = (size[0] * FINER, size[1] * FINER)
    camera = Camera.at(viewpoint, fine)
    light = Light(lighting, place)
    if place.indoors:
        background: Pixels = np.zeros((fine[1], fine[0], 3), np.uint8)
    else:
        background = sky(camera, light.day, moment)
    canvas = Canvas(camera, background, label("wall" if place.indoors else "sky"))
    surfaces, sprites = _passing(place, things, moment)
    for surface in [*_ground(place, light), *place.surfaces, *surfaces]:
        canvas.draw(surface, light.on)
    # The nearest first: what they hide is not worked out.
    for sprite in sorted([*place.sprites, *sprites], key=lambda sprite: float(camera.seen(sprite.centre)[2])):
        canvas.draw_sprite(sprite, light.on_sprite)
    colours = canvas.colours if place.indoors else hazed(canvas.colours, canvas.closeness, light.day)
    pixels = cv2.resize(colours, size, interpolation=cv2.INTER_AREA)
    labels = np.ascontiguousarray(canvas.labels[FINER // 2 :: FINER, FINER // 2 :: FINER])
    return developed(pixels, light.day, moment), labels


def _passing(place: Place, things: tuple[str, ...], moment: np.random.Generator) -> tuple[list[Surface], list[Sprite]]:
    surfaces: list[Surface] = []
    sprites: list[Sprite] = []
    for thing in things:
        x, y, heading = place.stands[thing]
        x, y = x + float(moment.normal(0, 0.2)), y + float(moment.normal(0, 0.3))
        if thing == "bus":
            surfaces += passing.bus(moment, x, y, heading)
        elif thing == "car":
            surfaces += passing.car(moment, x, y, heading)
        else:
            sprites.append(passing.person(moment, x, y))
    return surfaces, sprites


def scene(name: str, kind: Kind | None = None) -> Scene:
    """The place of a name: the same name is always the same place.

    Without `kind`, words such as "park" or "corridor" in the name decide it; other names are streets.
    """
    named = next((k for word, k in _KIND_BY_WORD.items() if word in name.lower()), "street")
    return Scene(digest(name), kind or named)  # type: ignore[arg-type]


def digest(text: str) -> int:
    """A seed of 32 bits from a text, the same in every process."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def _ground(place: Place, light: Light) -> list[Surface]:
    """The ground with its shadows, in strips that are each drawn at the resolution their distance needs."""
    if place.ground is None or place.ground_texture is None or place.ground_labels is None:
        return []
    x0, x1, y0, y1 = place.ground
    texture, labels = place.ground_texture, place.ground_labels
    if not place.indoors:
        small = (texture.shape[0] // 3, texture.shape[1] // 3)
        factor = light.shadow_map(place, small)
        grown = cv2.resize(factor, (texture.shape[1], texture.shape[0]), interpolation=cv2.INTER_LINEAR)
        lit = np.empty_like(texture)
        for band in bands(len(texture)):
            lit[band] = (texture[band] * grown[band, :, None]).astype(np.uint8)
        texture = lit
    rows = texture.shape[0]
    strips, edge, step = [], y0, 3.0
    while edge < y1:
        far = min(y1, edge + step)
        a, b = round((y1 - far) / (y1 - y0) * rows), round((y1 - edge) / (y1 - y0) * rows)
        if b > a:
            strips.append(
                Surface(
                    vector(x0, far, 0),
                    vector(x1 - x0, 0, 0),
                    vector(0, edge - far, 0),
                    np.ascontiguousarray(texture[a:b]),
                    np.ascontiguousarray(labels[a:b]),
                )
            )
        edge, step = far, step * 1.35
    return strips
