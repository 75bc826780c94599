"""What the encoder sees, drawn for the documents: ``python -m lab.benchmarks.portraits --to docs``.

``seen.jpg``: a street, its labels and its context graph. ``limits.jpg``: scenes in which the labels go wrong, each
beside them. All images are scenes that the project draws itself.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lab.evaluation.in_process import runtime_for_measuring
from scenes.geometry import Pixels
from scenes.scene import scene
from schemas.image import Image
from schemas.settings import Settings
from worker.description.presets import Wanted

SEEN = scene("market street").behind("car", "person")

LIMITS = (
    scene("market street").at("night").behind("bus"),
    scene("north corridor").seen_from(ahead=2.0, turn=25),
    scene("rose garden").at("dusk"),
    scene("mill lane").seen_from(ahead=4.0, tilt=18),
)
"""A dark vehicle, a wall from near, dusk in a park, and facades without a road below them."""

WIDTH = 560


def side_by_side(*images: Pixels) -> Pixels:
    """Images in a row, from the top, on white."""
    height = max(len(p) for p in images)
    filled = [np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=255) for p in images]
    return np.concatenate(filled, axis=1)


def _decoded(png: bytes) -> Pixels:
    """An RGB drawing from PNG, its key below left as it is, at the width of the others."""
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise ValueError("a drawing is no PNG")
    return _at_width(np.asarray(pixels, np.uint8))


def _at_width(pixels: Pixels) -> Pixels:
    size = (WIDTH, round(pixels.shape[0] * WIDTH / pixels.shape[1]))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def _write(pixels: Pixels, path: Path) -> None:
    if not cv2.imwrite(str(path), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82]):
        raise OSError(f"{path} could not be written")
    print(f"{path}: {pixels.shape[1]} x {pixels.shape[0]}, {path.stat().st_size / 1000:.0f} KB")


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw both images."""
    parser = argparse.ArgumentParser(description="what the encoder sees, drawn for the documents")
    parser.add_argument("--to", type=Path, default=Path("docs"))
    options = parser.parse_args(arguments)
    with runtime_for_measuring(Settings(encoder="compact", threads=1)) as runtime:
        owner = runtime.services.maps.put("portraits", Wanted())[0].record
        draw = runtime.services.renderings
        street = Image.of(SEEN.pixels)
        drawn = [_decoded(draw.draw_overlay(street, owner, legend=True)), _decoded(draw.draw_graph(street, owner))]
        _write(side_by_side(_at_width(street.pixels), *drawn), options.to / "seen.jpg")
        rows = []
        for limit in LIMITS:
            overlay = _decoded(draw.draw_overlay(Image.of(limit.pixels), owner, legend=True))
            rows.append(side_by_side(_at_width(limit.pixels), overlay))
    columns = [np.concatenate(rows[at::2], axis=0) for at in range(2)]
    _write(side_by_side(*columns), options.to / "limits.jpg")


if __name__ == "__main__":
    main()
