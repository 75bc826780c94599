"""Whether one wall is taken for another: ``./revisit benchmark placeless [--images FOLDER]``.

A map has drawn streets and corridors and one image of a kind that shows no place (`scenes.placeless`). It is queried
with others of the kind, which it must not match, and with a part of the same image, which it must; by a service
that compares queries with the impostors that ship, and by one that does not. FOLDER holds images of other kinds, in a
folder for each.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np

from lab.benchmarks.floors import VERDICTS, encoded
from lab.datasets.dataset import ENDINGS
from lab.evaluation.in_process import runtime_for_measuring, train_vocabulary
from lab.evaluation.once import DescribeOnce
from lab.evaluation.querying import PATIENCE_S
from scenes import scene
from scenes.geometry import Pixels
from scenes.placeless import KINDS, placeless
from scenes.scene import Kind
from schemas.recipe import MapRecipe
from schemas.records import ViewAttributes
from schemas.settings import Settings
from worker.description.describers import Describers
from worker.description.presets import Wanted, make_recipe
from worker.runtime import Runtime

STREETS: tuple[Kind, ...] = ("street", "corridor")
FIRST_SEED = 1000
"""Seeds of the images; those that ship described have smaller ones."""

CUT = 24
"""Rows and columns that the same image lacks when it queries."""


@dataclass(frozen=True)
class Verdicts:
    """How often each verdict was given.

    Parameters
    ----------
    others, same : Counter of str
        For other images of the kind, and for a part of the enrolled one.
    """

    others: Counter[str] = field(default_factory=Counter)
    same: Counter[str] = field(default_factory=Counter)


def measured(
    runtime: Runtime, recipe: MapRecipe, name: str, images: Sequence[Pixels], places: Sequence[bytes], maps: int
) -> Verdicts:
    """Verdicts of several maps, each with the places and another of the first images."""
    found = Verdicts()
    for number in range(maps):
        map_name = f"{name}-{number}"
        runtime.store.maps.put(map_name, recipe, datetime.now(UTC))
        for at, view in enumerate([*places, encoded(images[number])]):
            attributes = ViewAttributes(place=f"place {at}")
            runtime.services.enroll.enroll(view, map_name, attributes, patience_s=PATIENCE_S)
        runtime.comparer.all()  # as the service does in the background
        for at, image in enumerate(images):
            is_same = at == number
            sent = encoded(image[CUT:, CUT:] if is_same else image)
            verdict = runtime.services.query.query(sent, map_name).decision.status
            (found.same if is_same else found.others)[verdict] += 1
        runtime.services.maps.delete(map_name)
    return found


def recipe_by(runtime: Runtime, folder: Path | None) -> MapRecipe:
    """The preset `default`, with the vocabulary that ships or one that is learned from the images in a folder."""
    recipe = make_recipe(runtime.encoder, Wanted(), preset="default")
    if folder is None:
        return recipe
    images = sorted(path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS)
    description = recipe.description
    learned = train_vocabulary(runtime, images, runtime.describers.of(description), description.parameters)
    return make_recipe(runtime.encoder, Wanted(), preset="default", vocabulary=learned)


def drawn(count: int) -> dict[str, list[Pixels]]:
    """So many images of each kind that the project draws."""
    return {kind: [placeless(kind, FIRST_SEED + seed) for seed in range(count)] for kind in KINDS}


def read(folder: Path, count: int) -> dict[str, list[Pixels]]:
    """The first so many images of each folder below a folder, RGB."""
    kinds = {}
    for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
        decoded = (cv2.imread(str(path), cv2.IMREAD_COLOR_RGB) for path in sorted(inner.iterdir()))
        kinds[inner.name] = [np.asarray(one, np.uint8) for one in decoded if one is not None][:count]
    return kinds


def table(rows: Mapping[str, Mapping[str, Verdicts]]) -> str:
    """Markdown: of each kind, the verdicts without and with the impostors."""
    lines = [
        "| kind | others: matched, ambiguous, no_match | with impostors | the same: matched of | with impostors |",
        "| --- | --- | --- | --- | --- |",
    ]
    for kind, by in rows.items():
        others = [", ".join(str(one.others[verdict]) for verdict in VERDICTS) for one in by.values()]
        same = [f"{one.same['matched']} of {one.same.total()}" for one in by.values()]
        lines.append(f"| {kind} | {others[0]} | {others[1]} | {same[0]} | {same[1]} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command-line entry point."""
    parser = argparse.ArgumentParser(
        prog="revisit benchmark placeless", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--images", type=Path, help="folder with a folder of images for each kind; default: drawn")
    parser.add_argument("--encoder", default="compact")
    parser.add_argument("--count", type=int, default=13, help="of each kind")
    parser.add_argument("--maps", type=int, default=3, help="of each kind, each with another image enrolled")
    parser.add_argument("--places", type=int, default=20, help="drawn places that each map has besides")
    parser.add_argument("--learn-from", type=Path, help="images that the vocabulary is learned from; default: it ships")
    options = parser.parse_args(arguments)
    kinds = read(options.images, options.count) if options.images else drawn(options.count)
    places = [encoded(scene(f"placeless {n}", STREETS[n % 2]).pixels) for n in range(options.places)]
    settings = Settings(encoder=options.encoder, threads=1)
    rows: dict[str, dict[str, Verdicts]] = {kind: {} for kind in kinds}
    with runtime_for_measuring(settings, make_scheduler=DescribeOnce) as runtime:
        recipe = recipe_by(runtime, options.learn_from)
        for by, (kind, images) in product(("without", "with"), kinds.items()):
            compared = Describers.impostors if by == "with" else lambda describers, recipe: None
            with patch.object(Describers, "impostors", compared):
                rows[kind][by] = measured(runtime, recipe, f"{kind}-{by}", images, places, options.maps)
    total = {by: Verdicts() for by in ("without", "with")}
    for of_kind in rows.values():
        for by, one in of_kind.items():
            total[by].others.update(one.others)
            total[by].same.update(one.same)
    print(table({**rows, "all": total}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
