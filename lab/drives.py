"""Measure drives: what is ``matched`` when the images of a walk are queried as one drive, in order and otherwise.

``python -m lab.drives pairs --root DIR``. Maps are made in the order of the path: of everything, and of every other
stretch. Each image is queried once, and what it says alone is followed in every order: shuffled, backwards, every
second one, and with stops. SeqSLAM stands beside them, which knows nothing but the order; with ``--no-service`` it
stands alone.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from lab.baselines.seqslam import CLAIMED, SeqSlam, matched
from lab.datasets.choosing import add_dataset_arguments, add_device, chosen, read
from lab.datasets.dataset import Dataset
from lab.datasets.layout import with_attributes
from lab.datasets.protocols import Query, Trial, halves, whole
from lab.evaluation.deciding import is_right
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from lab.evaluation.querying import position_of
from lab.evaluation.service import ServiceRetriever, map_of_its_own
from schemas.description import Booleans, Doubles
from schemas.errors import RevisitError
from schemas.settings import read_settings
from worker.description.presets import Wanted, make_recipe
from worker.service.drives import Drives
from worker.service.query import QueryResult
from worker.service.query_options import QueryOptions

FOREVER_S = 86400.0
HEADING = (
    "| walk | single images | as a drive | shuffled | backwards | every second: single images | as a drive "
    "| with stops: single images | as a drive "
    "| SeqSLAM | without local contrast | shuffled |"
)
PRECISION = 0.97
"""Of claims, that SeqSLAM's threshold is chosen for when it may know the answers."""
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
        share = f"share {self.right / max(self.first, 1):.2f}"
        return f"{self.right} of {self.matched} matched right, {share}, first {self.first}"

    def __add__(self, other: "Counts") -> "Counts":
        return Counts(self.matched + other.matched, self.right + other.right, self.first + other.first)


def alone(trial: Trial, service: ServiceRetriever) -> list[QueryResult]:
    """What the service says of each query as the first image of a drive of its own."""
    query = service.runtime.services.query
    return [
        query.query(one.image.read_bytes(), service.map_name, options=QueryOptions(drive=f"image-{index}", keep=False))
        for index, one in enumerate(trial.queries)
    ]


def drive(
    trial: Trial, followed: Drives, answers: Sequence[QueryResult], images: Mapping[str, set[int]], order: Sequence[int]
) -> tuple[Counts, Counts]:
    """Follow the images in some order: counts of their verdicts alone, and of the drive's.

    Parameters
    ----------
    trial : Trial
        Whose images are enrolled.
    followed : Drives
        That know of no drive yet.
    answers : sequence of QueryResult
        As `alone` gives them.
    images : mapping of view id to set of int
        As `enrolled_in_order` gives them.
    order : sequence of int
        Indices of the trial's queries.
    """
    counts = [Counts(0, 0, 0), Counts(0, 0, 0)]
    for index in order:
        single = answers[index]
        results, decision, _ = followed.follow(("map", "drive"), FOREVER_S, single.results, single.decision)
        driven = replace(single, found=(replace(single.leading, results=results),), decision=decision)
        for kind, result in enumerate((single, driven)):
            right = is_right(result, trial.queries[index], images, trial.dataset)
            sure = result.decision.status == "matched"
            counts[kind] += Counts(int(sure), int(sure and right), int(right))
    return counts[0], counts[1]


@dataclass(frozen=True, eq=False)
class Claims:
    """SeqSLAM's answers to the queries of one map.

    Parameters
    ----------
    quotient : float64 of shape (queries,)
        As of `lab.baselines.seqslam.Matched`: small where a place is unique.
    right : bool of shape (queries,)
    """

    quotient: Doubles
    right: Booleans

    def counts(self, threshold: float = CLAIMED) -> Counts:
        """What is claimed at a threshold of the quotient."""
        claimed = self.quotient <= threshold
        return Counts(int(claimed.sum()), int((claimed & self.right).sum()), int(self.right.sum()))


def sequences(trial: Trial, order: Sequence[int], seqslam: SeqSlam) -> Claims:
    """Query SeqSLAM in some order, the trial's images enrolled in the order of the path."""
    enrolled = np.sort(trial.enrolled)
    database = [trial.dataset.database[image] for image in enrolled]
    queries = [trial.queries[index] for index in order]
    found = matched(seqslam.rank(database, [one.image for one in queries], lambda: None))
    answers = zip(queries, enrolled[found.image].tolist(), strict=True)
    return Claims(found.quotient, np.array([_is_right(trial.dataset, one, image) for one, image in answers], np.bool_))


def _is_right(dataset: Dataset, query: Query, image: int) -> bool:
    """Whether a database image is a right answer, or has the name of a right one's place."""
    if query.kind != "known":
        return False
    if image in query.right:
        return True
    return dataset.places is not None and dataset.places[image] in {dataset.places[right] for right in query.right}


def best_threshold(claims: Sequence[Claims], precision: float = PRECISION) -> float:
    """The largest quotient at which so many of all claims are right; 0 where there is none. It knows the answers."""
    quotients = np.concatenate([one.quotient for one in claims])
    order = np.argsort(quotients, kind="stable")
    rightly = np.cumsum(np.concatenate([one.right for one in claims])[order])
    # Claims with the same quotient are made together.
    last = np.append(np.diff(quotients[order]) > 0, True)
    kept = np.flatnonzero(last & (rightly >= precision * np.arange(1, len(order) + 1)))
    return float(quotients[order][kept[-1]]) if len(kept) else 0.0


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


def drives(service: ServiceRetriever, trial: Trial, seed: int) -> list[Counts]:
    """Counts of one map, for the columns of `HEADING` up to SeqSLAM's."""
    images = enrolled_in_order(trial, service)
    service.runtime.comparer.all()
    answers, further = alone(trial, service), service.runtime.services.searcher.further
    in_order, jumble = orders(trial, seed)
    stops = stop_and_go(len(in_order), np.random.default_rng(seed))
    ways = (in_order, jumble, in_order[::-1], in_order[::2], stops)
    (single, driven), (_, jumbled), (_, back), second, standing = (
        drive(trial, Drives(further), answers, images, order) for order in ways
    )
    return [single, driven, jumbled, back, *second, *standing]


def orders(trial: Trial, seed: int) -> tuple[list[int], list[int]]:
    """The queries in order, and shuffled."""
    count = len(trial.queries)
    return list(range(count)), np.random.default_rng(seed).permutation(count).tolist()


def row(name: str, counts: Sequence[Counts | None]) -> str:
    """A row of the table; nothing stands where nothing was measured."""
    cells = ["" if one is None else str(one) for one in counts]
    return f"| {name} | {' | '.join(cells)} |"


def summed(rows: Sequence[Sequence[Counts | None]]) -> list[Counts | None]:
    """Counts of some maps together."""
    return [sum(filter(None, column[1:]), column[0]) if column[0] else None for column in zip(*rows, strict=True)]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="python -m lab.drives", description=__doc__.splitlines()[0])
    add_dataset_arguments(parser)
    add_device(parser)
    parser.add_argument("--no-service", action="store_true", help="SeqSLAM only")
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    options = parser.parse_args(argv)
    try:
        walks = chosen(read(options.dataset, options), options.sets, walks=True)
        trials = [trial for one in map(with_attributes, walks) for trial in [whole(one), *halves(one)]]
        with served(options) as measured:
            print(HEADING + "\n" + "|---" * (HEADING.count("|") - 1) + "|")
            published, plain = SeqSlam(), SeqSlam(local_contrast=False)
            claims: dict[str, list[Claims]] = defaultdict(list)
            rows: dict[str, list[list[Counts | None]]] = defaultdict(list)
            for trial in trials:
                in_order, jumble = orders(trial, options.seed)
                first, second = (sequences(trial, in_order, one) for one in (published, plain))
                claims[published.name].append(first)
                claims[plain.name].append(second)
                others = [one.counts() for one in (first, second, sequences(trial, jumble, plain))]
                rows[trial.protocol].append([*measured(trial), *others])
                print(row(f"{trial.dataset.name}, {trial.protocol}", rows[trial.protocol][-1]), flush=True)
            for protocol, some in rows.items():
                print(row(f"all, {protocol}", summed(some)))
        for name, made in claims.items():
            print(summary(name, made))
    except (RevisitError, ValueError) as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


@contextmanager
def served(options: argparse.Namespace) -> Iterator[Callable[[Trial], Sequence[Counts | None]]]:
    """What measures the service on one map, as `drives` does; nothing with ``--no-service``."""
    if options.no_service:
        yield lambda _: [None] * (HEADING.count("|") - 5)
        return
    with runtime_for_measuring(read_settings(), options.device, make_scheduler=DescribeOnce) as runtime:
        recipe = make_recipe(runtime.encoder, Wanted(), preset="default")

        def measured(trial: Trial) -> list[Counts]:
            with map_of_its_own(runtime, recipe, "default", trial.dataset) as service:
                return drives(service, trial, options.seed)

        yield measured


def summary(name: str, claims: Sequence[Claims]) -> str:
    """A variant of SeqSLAM on all maps together, at the published threshold and at the best one."""
    together = Claims(np.concatenate([c.quotient for c in claims]), np.concatenate([c.right for c in claims]))
    best = best_threshold(claims)
    return (
        f"{name}, all maps: {together.counts()}; at {best:.3f}, the threshold that keeps {PRECISION:.0%} right and is "
        f"chosen with the answers: {together.counts(best)}"
    )


if __name__ == "__main__":
    sys.exit(main())
