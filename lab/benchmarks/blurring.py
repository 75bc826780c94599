"""What blurring covers, and what it costs recognition.

``python -m lab.benchmarks.blurring covered DIR`` compares what is covered with labelled images; ``... recognised
--root DIR MAP QUERIES`` enrols a walk as it is and blurred, and queries both with another.
"""

import argparse
import json
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from lab.datasets.dataset import images_in
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.querying import PATIENCE_S
from schemas.blur import BLUR_GROUPS
from schemas.description import Booleans
from schemas.image import Image
from schemas.records import Position, ViewAttributes
from schemas.settings import MEGA, Settings
from worker.description.presets import Wanted
from worker.images.filling import mask_of
from worker.runtime import Runtime
from worker.service.blurring import Blurring

EXPECTED = "  DIR/MAP/, DIR/QUERIES/   images; number i of one shows the place of number i of the other"
TOLERANCE = 2
"""Frames by which a right answer may differ."""

SMALLEST = 100
"""Pixels of the smallest region that is counted by itself."""

IGNORED = 255

ALSO = {"people": {"pedestrian", "child", "rider"}, "vehicles": {"train"}}
"""Words of data sets besides those of the groups."""


@dataclass(frozen=True)
class Coverage:
    """Shares of labelled pixels and connected regions, 0..1.

    Parameters
    ----------
    pixels : float
        Of the pixels of such things, those that are covered.
    rest : float
        Of all other pixels, those that are covered.
    regions : int
    whole, less_than_half : float
        Of the regions, those covered by nine tenths at least, and by less than half.
    """

    pixels: float
    rest: float
    regions: int
    whole: float
    less_than_half: float


@dataclass(frozen=True)
class Row:
    """Shares over the queries, and the median time of an enrolment."""

    name: str
    recall: float
    matched: float
    right: float
    enrol_ms: float


def labelled(folder: Path, group: str, every: int = 1) -> Iterator[tuple[Image, Booleans, Booleans]]:
    """Image, pixels of a group, and labelled pixels, of a folder with images/, labels/ and ../classes.json.

    `every`: of every n-th image.
    """
    classes = json.loads((folder.parent / "classes.json").read_text())
    words = {*BLUR_GROUPS[group], *ALSO[group]}
    # The first word of a class is its name; further ones are what else it holds.
    wanted = [int(number) for number, names in classes.items() if names[0] in words]
    for path in sorted((folder / "images").iterdir())[::every]:
        truth = np.asarray(cv2.imread(str(folder / "labels" / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED))
        image = Image.of(np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR_RGB), np.uint8))
        yield image, np.isin(truth, wanted), truth != IGNORED


def coverage(blurring: Blurring, examples: Iterator[tuple[Image, Booleans, Booleans]], group: str) -> Coverage:
    """What is covered of labelled images."""
    hit = true = extra = rest = 0
    shares: list[float] = []
    for image, wanted, known in examples:
        mask = mask_of(blurring.cells(image, [group]), image.width, image.height)
        hit, true = hit + int((mask & wanted).sum()), true + int(wanted.sum())
        other = known & ~wanted
        extra, rest = extra + int((mask & other).sum()), rest + int(other.sum())
        count, numbered, stats, _ = cv2.connectedComponentsWithStats(wanted.astype(np.uint8), connectivity=8)
        for number in range(1, count):
            size = int(stats[number, cv2.CC_STAT_AREA])
            if size >= SMALLEST:
                shares.append(float((mask & (numbered == number)).sum()) / size)
    found = np.array(shares or [0.0])
    whole, poor = float((found >= 0.9).mean()), float((found < 0.5).mean())
    return Coverage(hit / max(true, 1), extra / max(rest, 1), len(shares), whole, poor)


def recognised(runtime: Runtime, walks: Sequence[Sequence[Path]]) -> list[Row]:
    """Answers to the second walk by a map of the first, as it is and blurred."""
    base, queries = walks
    rows = []
    for name, words in (("as-sent", []), ("blurred", list(BLUR_GROUPS))):
        runtime.services.maps.put(name, Wanted())
        if words:
            runtime.services.maps.change(name, blur=words)
        times = []
        for frame, path in enumerate(base):
            given = ViewAttributes(position=Position(x=float(frame), y=0.0))
            began = time.perf_counter()
            runtime.services.enroll.enroll(path.read_bytes(), name, given, patience_s=PATIENCE_S)
            times.append((time.perf_counter() - began) * 1000)
        runtime.comparer.all()
        answers = [runtime.services.query.query(path.read_bytes(), name) for path in queries]
        found = [answer.results.views[0].view.attributes.position.x for answer in answers]
        right = [x is not None and abs(x - frame) <= TOLERANCE for frame, x in enumerate(found)]
        matched = [answer.decision.status == "matched" for answer in answers]
        both = sum(a and b for a, b in zip(right, matched, strict=True))
        count = max(len(answers), 1)
        rows.append(
            Row(name, sum(right) / count, sum(matched) / count, both / max(sum(matched), 1), statistics.median(times))
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.benchmarks.blurring", description=(__doc__ or "").splitlines()[0]
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    covered = verbs.add_parser("covered", help="labelled images: what is covered of people and vehicles")
    covered.add_argument("folder", type=Path, help="with images/ and labels/; classes.json beside it")
    covered.add_argument("--every", type=int, default=1, help="use every n-th image")
    walked = verbs.add_parser("recognised", help="two walks: what blurring costs")
    walked.add_argument("--root", type=Path, required=True)
    walked.add_argument("walks", nargs=2, metavar="FOLDER", help="enrolled, queried: folders of --root")
    walked.add_argument("--every", type=int, default=1, help="use every n-th frame")
    given = parser.parse_args(arguments)
    with runtime_for_measuring(Settings()) as runtime:
        if given.verb == "covered":
            blurring = Blurring(runtime.encoder, runtime.scheduler, MEGA)
            print("| what | of its pixels | of others | regions | nine tenths covered | less than half |")
            print("|---|---|---|---|---|---|")
            for group in BLUR_GROUPS:
                one = coverage(blurring, labelled(given.folder, group, given.every), group)
                shares = f"{one.regions} | {one.whole:.3f} | {one.less_than_half:.3f}"
                print(f"| {group} | {one.pixels:.3f} | {one.rest:.3f} | {shares} |", flush=True)
        else:
            walks = [images_in(given.root / name, EXPECTED)[:: given.every] for name in given.walks]
            print("| enrolled | recall@1 | matched | right of those matched | ms an enrolment |")
            print("|---|---|---|---|---|")
            for row in recognised(runtime, walks):
                print(f"| {row.name} | {row.recall:.3f} | {row.matched:.3f} | {row.right:.3f} | {row.enrol_ms:.0f} |")


if __name__ == "__main__":
    main()
