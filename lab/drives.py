"""Measure drives: what is ``matched`` when the images of a walk are queried as one drive, in order, shuffled, and with
stops.

``python -m lab.drives pairs --root DIR``. Maps are made in the order of the path: of everything, and of every other
stretch.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lab import evaluate
from lab.datasets.dataset import Dataset
from lab.datasets.layout import with_attributes
from lab.datasets.protocols import Trial, halves, whole
from lab.evaluation.deciding import is_right
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from lab.evaluation.querying import position_of
from lab.evaluation.service import ServiceRetriever, map_of_its_own
from schemas.errors import RevisitError
from schemas.settings import read_settings
from worker.description.presets import Wanted, make_recipe

FOREVER_S = 86400.0
GOING, STANDING = (3, 9), (2, 7)
"""Images from one stop to the next, and queries with the image of a stop, at least and below."""


@dataclass(frozen=True)
class Counts:
    """Answers to the queries of one map.

    Parameters
    ----------
    matched, right : int
        Answers that are `matched`, and how many of these are right.
    first : int
        Answers whose first view is right, whatever the verdict.
    """

    matched: int
    right: int
    first: int

    def __str__(self) -> str:
        return f"{self.right} of {self.matched} matched right, share {self.right / max(self.first, 1):.2f}"


def drive(
    trial: Trial, service: ServiceRetriever, images: Mapping[str, set[int]], order: Sequence[int], name: str
) -> tuple[Counts, Counts]:
    """Query in some order: counts of the single images' verdicts, and of the drive's.

    Parameters
    ----------
    trial : Trial
        Whose images are enrolled.
    service : ServiceRetriever
    images : mapping of view id to set of int
        As `enrolled_in_order` gives them.
    order : sequence of int
        Indices of the trial's queries.
    name : str
        Of the drive.
    """
    tally: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    query = service.runtime.services.query
    for index in order:
        one = trial.queries[index]
        data = one.image.read_bytes()
        single = query.query(data, service.map_name)
        driven = query.query(data, service.map_name, drive=name, drive_timeout_s=FOREVER_S)
        for kind, result in (("single", single), ("drive", driven)):
            right = is_right(result, one, images, trial.dataset)
            tally[kind].append((result.decision.status == "matched", right))
    single_counts, driven_counts = (
        Counts(sum(m for m, _ in rows), sum(m and r for m, r in rows), sum(r for _, r in rows))
        for rows in (tally["single"], tally["drive"])
    )
    return single_counts, driven_counts


def stop_and_go(count: int, random: np.random.Generator) -> list[int]:
    """Indices of `count` images in order, some of them several times in a row: the camera stands there."""
    order: list[int] = []
    going = int(random.integers(*GOING))
    for index in range(count):
        going -= 1
        order += [index] * (1 if going else int(random.integers(*STANDING)))
        going = going or int(random.integers(*GOING))
    return order


def enrolled_in_order(trial: Trial, service: ServiceRetriever) -> dict[str, set[int]]:
    """Enrol a trial's images in the order of the path; the database images that each view stands for."""
    dataset, images = trial.dataset, defaultdict(set)
    for image in sorted(trial.enrolled.tolist()):
        place = None if dataset.places is None else dataset.places[image]
        images[service.enroll(dataset.database[image], position_of(dataset, image), place)].add(image)
    return images


def measure(dataset: Dataset, service: ServiceRetriever, trial: Trial, seed: int) -> str:
    """A row of the table: one map, its queries in order, shuffled, and with stops."""
    images = enrolled_in_order(trial, service)
    service.runtime.comparer.all()
    count = len(trial.queries)
    shuffled = np.random.default_rng(seed).permutation(count).tolist()
    orders = {
        "in-order": range(count),
        "shuffled": shuffled,
        "stop-and-go": stop_and_go(count, np.random.default_rng(seed)),
    }
    cells = []
    for name, order in orders.items():
        single, together = drive(trial, service, images, order, name)
        cells += [str(together)] if name == "shuffled" else [str(single), str(together)]
    return f"| {dataset.name}, {trial.protocol} | {' | '.join(cells)} |"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="drives", description=__doc__.splitlines()[0])
    evaluate.add_arguments(parser)
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    options = parser.parse_args(argv)
    try:
        sets = [one for one in evaluate.read(options.dataset, options) if one.sequential]
        chosen = [one for one in sets if one.name.startswith(tuple(options.sets.split(",")))]
        with runtime_for_measuring(read_settings(), options.device, make_scheduler=DescribeOnce) as runtime:
            recipe = make_recipe(runtime.encoder, Wanted(), preset="default")
            heads = "single images", "as a drive", "the same, shuffled", "with stops: single images", "as a drive"
            print(f"| walk | {' | '.join(heads)} |\n|---|---|---|---|---|---|")
            for dataset in map(with_attributes, chosen):
                for trial in [whole(dataset), *halves(dataset)]:
                    with map_of_its_own(runtime, recipe, "default", dataset) as service:
                        print(measure(dataset, service, trial, options.seed), flush=True)
    except (RevisitError, ValueError) as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
