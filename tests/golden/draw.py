"""Draws the images of places anew, which changes every answer: ``python -m tests.golden.draw``."""

from collections.abc import Callable, Mapping

import numpy as np

from tests.golden.adapter import Pixels, drawn_place, encoded
from tests.golden.images import FOLDER, GREY, file_of

LANDSCAPE, UPRIGHT, SQUARE, WIDE = (256, 192), (192, 256), (192, 192), (360, 120)
QUALITY = 80


def _lane() -> Pixels:
    return drawn_place("mill lane", LANDSCAPE)


def _aside() -> Pixels:
    return drawn_place("mill lane", LANDSCAPE, dx=0.6, turn=3)


def _fog() -> Pixels:
    """A street in fog that leaves 5 % of its contrast."""
    return (GREY + (_aside().astype(np.int16) - GREY) // 20).astype(np.uint8)


DRAWN: Mapping[str, Callable[[], Pixels]] = {
    "lane": _lane,
    "lane, 2 m on": lambda: drawn_place("mill lane", LANDSCAPE, ahead=2.0),
    "lane, 5 m on": lambda: drawn_place("mill lane", LANDSCAPE, ahead=5.0),
    "lane, upright": lambda: drawn_place("mill lane", UPRIGHT),
    "lane, square": lambda: drawn_place("mill lane", SQUARE),
    "lane, wide": lambda: drawn_place("mill lane", WIDE),
    "station": lambda: drawn_place("station road", LANDSCAPE),
    "park": lambda: drawn_place("castle park", LANDSCAPE),
    "garden": lambda: drawn_place("rose garden", LANDSCAPE),
    "corridor": lambda: drawn_place("east corridor", LANDSCAPE),
    "hall": lambda: drawn_place("west corridor", LANDSCAPE),
    "chapel, upright": lambda: drawn_place("chapel row", UPRIGHT),
    "green, wide": lambda: drawn_place("the green", WIDE),
    "lane, aside": _aside,
    "lane, at dusk": lambda: drawn_place("mill lane", LANDSCAPE, "dusk", dx=0.4, turn=-2),
    "lane, at night": lambda: drawn_place("mill lane", LANDSCAPE, "night", dx=0.3),
    "lane, behind a bus": lambda: drawn_place("mill lane", LANDSCAPE, "noon", ["bus"], dx=0.4),
    "lane, 3.5 m on": lambda: drawn_place("mill lane", LANDSCAPE, "overcast", ahead=3.5, turn=4),
    "lane, grey": lambda: _aside()[..., 1],  # one channel, as from a grey-scale camera
    "lane, tiny": lambda: drawn_place("mill lane", (48, 36), dx=0.3),
    "station, held upright": lambda: drawn_place("station road", UPRIGHT, dx=0.3, turn=2),
    "chapel, held across": lambda: drawn_place("chapel row", LANDSCAPE, dx=0.3),
    "park, dull": lambda: drawn_place("castle park", LANDSCAPE, "overcast", dx=-0.5, turn=3),
    "garden, behind a person": lambda: drawn_place("rose garden", LANDSCAPE, "noon", ["person"], dx=0.4),
    "corridor, turned": lambda: drawn_place("east corridor", LANDSCAPE, dx=0.2, turn=7),
    "stranger": lambda: drawn_place("foreign street", LANDSCAPE),
    "fog": _fog,
}

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, draw in DRAWN.items():
        file_of(name).write_bytes(encoded(draw(), quality=QUALITY, subsampling=2))
    file_of("lane, saved again").write_bytes(encoded(_lane(), quality=50, subsampling=2))
