"""Scenes that several processes of a test run draw are drawn by one: a place takes .4 s to build and .3 s to draw."""

from scenes.geometry import Pixels
from scenes.scene import Scene
from tests.once import once

DRAW = Scene.pixels.fget  # type: ignore[attr-defined]


def draw_once() -> None:
    """Have this process draw what no other has drawn."""

    def pixels(wanted: Scene) -> Pixels:
        drawn: Pixels = once(lambda: DRAW(wanted), "scene", repr(wanted).encode())
        return drawn

    Scene.pixels = property(pixels)  # type: ignore[method-assign, assignment]
