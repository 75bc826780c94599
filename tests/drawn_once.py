"""Scenes that several processes of a test run draw are drawn by one: a place takes .4 s to build and .3 s to draw."""

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from scenes.geometry import Pixels
from scenes.scene import Scene

FOLDER = "DRAWN_SCENES"
"""The environment variable that names the folder of this run, also to the processes that pytest-xdist starts."""

DRAW = Scene.pixels.fget  # type: ignore[attr-defined]


def make_folder() -> None:
    """Make the folder of this run."""
    os.environ[FOLDER] = tempfile.mkdtemp(prefix="revisit-scenes-")


def remove_folder() -> None:
    """Remove it, with what was drawn."""
    shutil.rmtree(os.environ.pop(FOLDER))


def draw_once() -> None:
    """Have this process take the pixels of a scene from the folder if they are there, and put them there if not."""
    folder = Path(os.environ[FOLDER])

    def pixels(wanted: Scene) -> Pixels:
        file = folder / f"{hashlib.sha256(repr(wanted).encode()).hexdigest()}.npy"
        try:
            found: Pixels = np.load(file)
        except FileNotFoundError:
            found = DRAW(wanted)
            with tempfile.NamedTemporaryFile(dir=folder, delete=False) as begun:
                np.save(begun, found)
            Path(begun.name).replace(file)  # whole, for whoever looks meanwhile
        return found

    Scene.pixels = property(pixels)  # type: ignore[method-assign, assignment]
