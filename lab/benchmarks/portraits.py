"""What the encoder sees, drawn for the documents: ``python -m lab.benchmarks.portraits --to docs``.

``seen.jpg``: a street, its labels and its context graph. ``limits.jpg``: scenes in which the labels go wrong, each
beside them. All pictures are scenes that the project draws itself.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from scenes.geometry import Pixels
from scenes.scene import Scene, scene
from schemas.description import PixelField
from schemas.image import Image
from schemas.settings import Settings
from worker.description.describer import Describer
from worker.description.presets import general_vocabulary, make_recipe
from worker.images import drawing
from worker.runtime import make_encoder

SEEN = scene("market street").behind("car", "person")

LIMITS = (
    scene("market street").at("night").behind("bus"),
    scene("north corridor").seen_from(ahead=2.0, turn=25),
    scene("rose garden").at("dusk"),
    scene("mill lane").seen_from(ahead=4.0, tilt=18),
)
"""A dark vehicle, a wall from near, dusk in a park, and facades without a road below them."""

WIDTH = 560


class Portraitist:
    """Pictures of what the default recipe makes of a picture."""

    def __init__(self) -> None:
        self._encoder = make_encoder(Settings(encoder="compact"), 1)
        recipe = make_recipe(self._encoder, "default")
        self._describer = Describer(self._encoder, recipe, general_vocabulary(self._encoder, "default"))

    def labels(self, image: Image) -> Pixels:
        """The labels over the picture, as `GET /views/{id}/segmentation.png?overlay=true` draws them."""
        seen = self._describer.segment(self._encoder.fine(image))
        return _decoded(
            drawing.overlay_png(image.pixels, seen.labels, self._describer.recipe.labels, seen.static), image
        )

    def graph(self, image: Image) -> Pixels:
        """The context graph over the picture."""
        field: PixelField = next(iter(self._encoder.encode([image])))
        recipe = self._describer.recipe
        graph = self._describer.graph(field, self._describer.segment(field))
        return _decoded(drawing.graph_png(image.pixels, graph, recipe.labels, recipe.parameters.graph.tau), image)


def _decoded(png: bytes, image: Image) -> Pixels:
    """An RGB picture from PNG, its key below left as it is, at the width of the others."""
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise ValueError(f"the drawing of a {image.width} x {image.height} picture is no PNG")
    return _at_width(np.asarray(pixels, np.uint8))


def _at_width(pixels: Pixels) -> Pixels:
    size = (WIDTH, round(pixels.shape[0] * WIDTH / pixels.shape[1]))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def parallel(*images: Pixels) -> Pixels:
    """Pictures side by side, from the top, on white."""
    height = max(len(p) for p in images)
    filled = [np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=255) for p in images]
    return np.concatenate(filled, axis=1)


def _written(pixels: Pixels, path: Path) -> None:
    if not cv2.imwrite(str(path), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 82]):
        raise OSError(f"{path} could not be written")
    print(f"{path}: {pixels.shape[1]} x {pixels.shape[0]}, {path.stat().st_size / 1000:.0f} KB")


def main() -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(description="what the encoder sees, drawn for the documents")
    parser.add_argument("--to", type=Path, default=Path("docs"))
    options = parser.parse_args()
    draw = Portraitist()
    street = Image.of(SEEN.pixels)
    _written(parallel(_at_width(street.pixels), draw.labels(street), draw.graph(street)), options.to / "seen.jpg")
    rows = []
    for limit in LIMITS:
        image = _image(limit)
        rows.append(parallel(_at_width(image.pixels), draw.labels(image)))
    halves = [np.concatenate(rows[at::2], axis=0) for at in range(2)]
    _written(parallel(*halves), options.to / "limits.jpg")


def _image(limit: Scene) -> Image:
    return Image.of(limit.pixels)


if __name__ == "__main__":
    main()
