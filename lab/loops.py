"""Measure loop closures: a walk, and its second time, through a service of its own by the client that users have.

``python -m lab.loops pairs --root DIR``. The database of a set is the first time round, its queries are the second.
Odometry drifts by 2 % of the way.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from revisit_client import Revisit
from revisit_client.loops import Keyframe, Loop, LoopCloser

from lab import evaluate
from lab.datasets.dataset import Dataset
from lab.faults.process import serve, settings
from schemas.errors import RevisitError

CONSISTENT = (1, 2, 3)
STEP_M = 2.0
"""Between two images, where a set has no positions."""

DRIFT = 0.02
EXCLUDED = 20


@dataclass(frozen=True)
class Counts:
    """Loops of one walk.

    Parameters
    ----------
    right, wrong : int
        Loops that lead to a right answer of the set, and all others, those of the first time round among them.
    known : int
        Images of the second time whose place the first time has shown.
    """

    right: int
    wrong: int
    known: int

    def __str__(self) -> str:
        return f"{self.right} of {self.known}, {self.wrong} wrong"


def walk(dataset: Dataset) -> Iterator[tuple[Path, Keyframe]]:
    """Twice the same way, each time with the same odometry but for what it has drifted meanwhile."""
    number = 0
    for images, positions in (
        (dataset.database, dataset.database_positions),
        (dataset.queries, dataset.query_positions),
    ):
        for index, image in enumerate(images):
            x, y = (0.0, STEP_M * index) if positions is None else map(float, positions[index])
            yield image, Keyframe(number, x + DRIFT * STEP_M * number, y)
            number += 1


def judged(dataset: Dataset, loops: Sequence[Loop]) -> Counts:
    """Which loops are right."""
    first = len(dataset.database)
    right = sum(
        loop.keyframe >= first and loop.earlier in set(dataset.positives[loop.keyframe - first].tolist())
        for loop in loops
    )
    return Counts(right, len(loops) - right, sum(len(positives) > 0 for positives in dataset.positives))


def measure(dataset: Dataset, consistent: int, *, drive: bool) -> Counts:
    """One walk through a service of its own."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        running = serve(data, settings(data, {"REVISIT_ENCODER": "compact", "REVISIT_THREADS": "0"}))
        try:
            with Revisit(running.url) as revisit:
                closer = LoopCloser(
                    revisit,
                    "walk",
                    exclude_last=EXCLUDED,
                    consistent=consistent,
                    drive="walk" if drive else None,
                )
                for image, keyframe in walk(dataset):
                    closer.add(image, keyframe)
        finally:
            running.stop()
            running.close()
    return judged(dataset, closer.loops)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="loops", description=__doc__.splitlines()[0])
    evaluate.add_arguments(parser)
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    options = parser.parse_args(argv)
    try:
        sets = [one for one in evaluate.read(options.dataset, options) if one.sequential]
        print("| walk | single | 2 agree | 3 agree | as a drive |\n|---|---|---|---|---|")
        for dataset in sets:
            if dataset.name.startswith(tuple(options.sets.split(","))):
                cells = [measure(dataset, count, drive=False) for count in CONSISTENT]
                cells.append(measure(dataset, 1, drive=True))
                print(f"| {dataset.name} | {' | '.join(map(str, cells))} |", flush=True)
    except (RevisitError, ValueError) as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
