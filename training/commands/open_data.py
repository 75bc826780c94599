"""Make a data folder that anybody may train on, from drawn scenes and openly licensed photographs.

``python -m training.commands.open_data --free FREE --text TEXT --to DIR`` draws scenes with exact labels and scenes in
several lights, and copies photographs whose licences allow commercial use; those under a share-alike licence (below
``by-sa``) are left out. What it writes has the layout that the training commands read as ``--data``; a run that was
stopped goes on where it was.
"""

import argparse
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import get_args

import cv2
import numpy as np

from scenes import LABELS
from scenes.building import Building, BuildingKind
from scenes.geometry import Pixels, Viewpoint
from scenes.scene import Kind, Lighting, Scene
from training.data.sources import CLIP_FILE

CLASSES: dict[str, Sequence[str]] = {
    "path": ("path", "pavement"),
    "tree": ("tree", "vegetation"),
    "sign": ("traffic sign", "signboard", "poster"),
    "lamp": ("lamp", "light"),
}
"""What a label of drawn scenes may be called in English, where that is more or other than its own name."""

SHARE_ALIKE = "by-sa"
ROOMS = ("pmndrs-hdri", "threejsfundamentals")
"""Sources that show rooms among other places: the pretrained trunk, which knows streets alone, does not label them."""

QUALITY = 92
THINGS = ("bus", "car", "person")


@dataclass(frozen=True)
class Drawing:
    """A drawn place seen in some way: what `images` of one number have in common is the place and the viewpoint.

    Parameters
    ----------
    number : int
        Decides everything but the light.
    """

    number: int

    def draw(self, light: Lighting) -> tuple[Pixels, Pixels]:
        """Image (uint8 RGB) and labels (uint8), both of one size."""
        rng = np.random.default_rng([7, self.number])
        size = [(512, 384), (480, 360), (560, 315)][rng.integers(3)]
        moved = Viewpoint(*(float(rng.uniform(-most, most)) for most in (0.8, 1.5, 0.2, 12.0, 4.0)))
        if self.number % 5 == 4:
            kind: BuildingKind = get_args(BuildingKind)[rng.integers(len(get_args(BuildingKind)))]
            building = Building(self.number, 2, 3, kind, size)
            near = Viewpoint(moved.dx / 3, moved.ahead / 4, moved.up, moved.turn / 2, moved.tilt)
            return building.view(1 + int(rng.integers(2)), 1 + int(rng.integers(3)), near, light)
        of = get_args(Kind)[self.number % 5 % 3]
        things = tuple(name for name in THINGS if rng.random() < (0.3 if of == "street" else 0.1))
        scene = Scene(self.number, of, light, moved, (), size)
        return scene.render(things=tuple(name for name in things if of != "corridor" or name == "person"))


def draw_labelled(folder: Path, count: int) -> Iterator[None]:
    """Write drawn scenes, each in one light, with label maps and ``classes.json``."""
    images, labels = folder / "train" / "images", folder / "train" / "labels"
    for part in (images, labels):
        part.mkdir(parents=True, exist_ok=True)
    named = {str(value): CLASSES.get(name, (name,)) for value, name in enumerate(LABELS)}
    (folder / "classes.json").write_text(json.dumps(named, indent=1))
    lights = get_args(Lighting)
    for number in range(count):
        image = images / f"{number:05}.jpg"
        if not image.exists():
            pixels, classes = Drawing(number).draw(lights[number // 5 % len(lights)])
            _write(labels / f"{number:05}.png", classes)
            _write(image, np.ascontiguousarray(pixels[:, :, ::-1]))
        yield


def draw_aligned(folder: Path, count: int, after: int) -> Iterator[None]:
    """Write drawn scenes from one viewpoint in every light, a folder each, of other places than the labelled ones."""
    for number in range(after, after + count):
        scene = folder / f"drawn-{number:05}"
        scene.mkdir(parents=True, exist_ok=True)
        for light in get_args(Lighting):
            image = scene / f"{light}.jpg"
            if not image.exists():
                _write(image, np.ascontiguousarray(Drawing(number).draw(light)[0][:, :, ::-1]))
        yield


def photographs(free: Path) -> list[Path]:
    """Photographs below a folder that are not share-alike, in order."""
    return [path for path in sorted(free.rglob("*.jpg")) if path.relative_to(free).parts[0] != SHARE_ALIKE]


def copy_photos(free: Path, to: Path) -> int:
    """Copy the photographs; returns how many there are."""
    photos = photographs(free)
    for path in photos:
        source, *rest = path.relative_to(free).parts
        folder = to / "unlabelled" / "free" / source if source in ROOMS else to / "segmentation" / "free" / "train"
        target = folder / ("" if source in ROOMS else "images") / "-".join((source, *rest))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    return len(photos)


def _write(path: Path, pixels: Pixels) -> None:
    """Write an image, whole or not at all."""
    partial = path.with_name(f"partial{path.suffix}")
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY] if path.suffix == ".jpg" else []
    if not cv2.imwrite(str(partial), pixels, options):
        raise SystemExit(f"{partial} cannot be written")
    partial.replace(path)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the folder."""
    parser = argparse.ArgumentParser(prog="training.commands.open_data", description=__doc__.partition("\n\n")[0])
    parser.add_argument("--free", type=Path, required=True, help="folder of openly licensed photographs")
    parser.add_argument("--text", type=Path, required=True, help="folder with the CLIP vectors of words")
    parser.add_argument("--to", type=Path, required=True)
    parser.add_argument("--labelled", type=int, default=800, help="drawn scenes with labels (default: 800)")
    parser.add_argument("--aligned", type=int, default=150, help="drawn scenes in every light (default: 150)")
    given = parser.parse_args(arguments)
    clip = given.to / CLIP_FILE
    clip.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(given.text / CLIP_FILE.name, clip)
    print(f"{copy_photos(given.free, given.to)} photographs")
    drawn = draw_labelled(given.to / "segmentation" / "drawn", given.labelled)
    aligned = draw_aligned(given.to / "pairs" / "aligned", given.aligned, given.labelled)
    for number, _ in enumerate(chain(drawn, aligned), 1):
        if number % 50 == 0:
            print(f"{number} drawn", flush=True)


if __name__ == "__main__":
    main()
