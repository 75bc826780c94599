"""Measure loop closures: a walk, and its second time, through a service of its own by the client that users have.

``python -m lab.loops pairs --root DIR``. The database of a set is the first time round, its queries are the second.
Odometry drifts by 2 % of the way. Meanwhile the service compares the views of the map in the background, and how far it
has come when a query arrives is a matter of time: each walk is repeated, and the table has the median, with the least
and the most in brackets.
"""

import argparse
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from revisit_client import Revisit
from revisit_client.loops import Keyframe, Loop, LoopCloser

from lab.datasets.choosing import add_dataset_arguments, chosen, read, whole
from lab.datasets.dataset import Dataset
from lab.faults.process import serve, settings
from schemas.errors import RevisitError
from worker.service.agreement import Row

CONSISTENT = (1, 2, 3)
"""How many keyframes in a row have to agree, in the columns of the table."""

STEP_M = 2.0
"""Metres between two images, where a set has no positions."""

DRIFT = 0.02
"""By how much odometry is off, as a share of the way."""

EXCLUDED = 20
"""Newest views that a keyframe is not compared with: it was there just before."""

Candidates = list[Loop | None]
"""For each keyframe of a walk the loop that it was recognised to close, or None."""


@dataclass(frozen=True)
class Counts:
    """Loops of one walk.

    Parameters
    ----------
    right, wrong : int
        Loops that lead to a right answer of the set, and all others, those of the first time round among them.
    """

    right: int
    wrong: int


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
    return Counts(right, len(loops) - right)


def certain(seen: Candidates, consistent: int) -> list[Loop]:
    """The loops of a whole walk where `consistent` keyframes must agree."""
    row, loops = Row(), []
    for end, last in enumerate(seen):
        row = row.followed_by(None if last is None else last.earlier)
        if row.images >= consistent:
            fresh = seen[end + 1 - consistent : end + 1] if row.images == consistent else [last]
            loops += [loop for loop in fresh if loop is not None]
    return loops


def run(dataset: Dataset, *, drive: bool) -> Candidates:
    """One walk through a service of its own: what each keyframe was recognised as."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        running = serve(data, settings(data, {"REVISIT_ENCODER": "compact", "REVISIT_THREADS": "0"}))
        try:
            with Revisit(running.url) as revisit:
                closer = LoopCloser(
                    revisit, "walk", exclude_last=EXCLUDED, consistent=1, drive="walk" if drive else None
                )
                for image, keyframe in walk(dataset):
                    closer.add(image, keyframe)
        finally:
            running.stop()
            running.close()
    return closer.seen


def cell(dataset: Dataset, walks: Sequence[Candidates], consistent: int) -> str:
    """Median of the repeated walks and their range."""
    counts = [judged(dataset, certain(seen, consistent)) for seen in walks]
    known = sum(len(positives) > 0 for positives in dataset.positives)
    right, wrong = _spread([count.right for count in counts]), _spread([count.wrong for count in counts])
    return f"{right} of {known}, {wrong} wrong"


def _spread(values: Sequence[int]) -> str:
    middle = f"{statistics.median(values):g}"
    return middle if min(values) == max(values) else f"{middle} ({min(values)}-{max(values)})"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="python -m lab.loops", description=__doc__.splitlines()[0])
    add_dataset_arguments(parser)
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    parser.add_argument("--repeat", type=whole(1), default=3, help="times that each walk is walked (3)")
    options = parser.parse_args(argv)
    try:
        walks = chosen(read(options.dataset, options), options.sets, walks=True)
        print("| walk | single | 2 agree | 3 agree | as a drive | as a drive, 3 agree |\n|---|---|---|---|---|---|")
        for dataset in walks:
            single, drive = ([run(dataset, drive=d) for _ in range(options.repeat)] for d in (False, True))
            cells = [cell(dataset, single, count) for count in CONSISTENT]
            cells += [cell(dataset, drive, count) for count in (1, 3)]
            print(f"| {dataset.name} | {' | '.join(cells)} |", flush=True)
    except (RevisitError, ValueError) as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
