"""What is lost where every image shows what carries the camera: ``python -m lab.benchmarks.carried --root DIR``.

Copies of some sets are made in which all images, enrolled and queried, have a drawn bonnet, a time stamp or black bars
(`scenes.carried`), and each is measured as `lab.decide` does: everything enrolled, and half of the places.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from PIL import Image as PilImage

from lab.datasets import pairs
from lab.datasets.dataset import Dataset
from lab.datasets.layout import with_attributes
from lab.datasets.protocols import halves, whole
from lab.evaluation.deciding import Decided, decide_all
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from lab.evaluation.progress import progress_bar
from lab.evaluation.service import map_of_its_own
from scenes.carried import CARRIED
from scenes.geometry import Pixels
from schemas.settings import read_settings
from worker.description.presets import Wanted, make_recipe
from worker.runtime import Runtime
from worker.service.query_options import QueryOptions

QUALITY = 94

HEADS = ("right first", "of these matched", "wrong matched", "unknown places matched")
"""What a `Row` tells."""

Draw = Callable[[Pixels], Pixels]


@dataclass(frozen=True)
class Row:
    """Of all sets together: queries, right first answers, those of them that were matched, and wrong ones that were."""

    queries: int
    right: int
    matched: int
    wrong_matched: int
    unknown: int
    unknown_matched: int

    def __str__(self) -> str:
        right, unknown = f"{self.right} of {self.queries}", f"{self.unknown_matched} of {self.unknown}"
        return f"{right} | {self.matched / max(self.right, 1):.2f} | {self.wrong_matched} | {unknown}"

    @classmethod
    def of(cls, decided: Iterable[Decided]) -> "Row":
        """Counts; known queries with everything enrolled, unknown ones with half of the places."""
        found = list(decided)
        known = [one for one in found if one.protocol == "everything" and one.kind == "known"]
        unknown = [one for one in found if one.kind == "same-site"]
        right = [one for one in known if one.right]
        return cls(
            len(known),
            len(right),
            sum(one.status == "matched" for one in right),
            sum(one.status == "matched" for one in known if not one.right),
            len(unknown),
            sum(one.status == "matched" for one in unknown),
        )


def redrawn(paths: Sequence[Path], draw: Draw, folder: Path) -> tuple[Path, ...]:
    """Images redrawn into a folder, each once."""

    def one(path: Path) -> Path:
        made = folder / path.parent.name / f"{path.stem}.jpg"
        if not made.exists():
            made.parent.mkdir(parents=True, exist_ok=True)
            with PilImage.open(path) as image:
                PilImage.fromarray(draw(np.asarray(image.convert("RGB")))).save(made, quality=QUALITY)
        return made

    return tuple(map(one, paths))


def carrying(dataset: Dataset, folder: Path, what: str) -> Dataset:
    """The set with something drawn into all its images."""
    if what == "nothing":
        return dataset
    database, queries = (redrawn(paths, CARRIED[what], folder) for paths in (dataset.database, dataset.queries))
    return replace(dataset, database=database, queries=queries)


def measure(
    sets: Sequence[Dataset],
    shown: Callable[[Dataset, Path], Dataset],
    runtime: Runtime,
    every: int,
    options: QueryOptions = QueryOptions(),
) -> Row:
    """Decide about every so manieth query of the sets, as `shown` redraws them into a folder."""
    recipe = make_recipe(runtime.encoder, Wanted(), preset="default")
    decided: list[Decided] = []
    with tempfile.TemporaryDirectory() as folder:
        for number, dataset in enumerate(map(with_attributes, sets)):
            drawn = shown(dataset, Path(folder) / str(number))
            for trial in (whole(drawn), *halves(drawn)[:1]):
                some = replace(trial, queries=trial.queries[::every])
                with progress_bar(dataset.name) as bar, map_of_its_own(runtime, recipe, "default", drawn) as service:
                    service.options = options
                    decided += decide_all(some, service, progress=bar)[0]
    return Row.of(decided)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m lab.benchmarks.carried", description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, required=True, help="folder of sets with tables of right answers")
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    parser.add_argument("--what", nargs="+", default=list(CARRIED), choices=list(CARRIED))
    parser.add_argument("--whole", action="store_true", help="leave nothing out of queries: what is lost without it")
    parser.add_argument("--every", type=int, default=4, help="take every so manieth query")
    options = parser.parse_args(argv)
    sets = [one for one in pairs.read(options.root) if one.name.startswith(tuple(options.sets.split(",")))]
    print(f"| in every image | {' | '.join(HEADS)} |\n| --- |{' --- |' * len(HEADS)}")
    with ExitStack() as stack:
        runtime = stack.enter_context(runtime_for_measuring(read_settings(), "cpu", make_scheduler=DescribeOnce))
        if options.whole:
            stack.enter_context(patch.object(type(runtime.catalogue), "camera_fixed", lambda *_: None))
        for what in options.what:
            print(f"| {what} | {measure(sets, partial(carrying, what=what), runtime, options.every)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
