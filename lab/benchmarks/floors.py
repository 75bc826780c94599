"""How look-alike floors are told apart: ``python -m lab.benchmarks.floors [--seeds 1 2 3] [--kinds corridor lobby]``.

With ``--apart`` each floor is a map of its own, and all of them are queried together.

Drawn buildings (`scenes.building`). Each spot of each floor is enrolled once, as a place of its own; then the same
floors and one that was never enrolled are queried from elsewhere, in other light.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import cv2

from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.querying import PATIENCE_S
from scenes.building import KINDS, Building, Shot, building
from scenes.geometry import Pixels
from schemas.records import ViewAttributes
from schemas.settings import Settings
from worker.description.presets import Wanted, make_recipe
from worker.runtime import Runtime

VERDICTS = ("matched", "ambiguous", "no_match")
QUALITY = 92


@dataclass(frozen=True)
class Answered:
    """The answer to one query: the place that came first, as (floor, spot), beside the true one, and the verdict."""

    truth: tuple[int, int]
    first: tuple[int, int]
    verdict: str

    @property
    def right(self) -> str:
        """How right the first answer is: ``spot``, ``floor`` (a neighbouring spot) or ``no``."""
        if self.first == self.truth:
            return "spot"
        return "floor" if self.first[0] == self.truth[0] else "no"


def measured(
    runtime: Runtime, preset: str, one: Building, count: int, *, apart: bool = False
) -> tuple[list[Answered], list[Answered]]:
    """Enrol a building and query it.

    Parameters
    ----------
    runtime : Runtime
        Started.
    preset : str
    one : Building
    count : int
        Queries of each spot.
    apart : bool
        Whether each floor is a map of its own, and all are queried together; otherwise the building is one map.

    Returns
    -------
    enrolled, unknown : list of Answered
        Answers to queries of the enrolled floors, and of the floor that was never enrolled.
    """
    whole = f"{one.kind}-{one.seed}"
    maps = [f"{whole}-{floor}" for floor in range(1, one.floors + 1)] if apart else [whole]
    recipe = make_recipe(runtime.encoder, Wanted(), preset=preset)
    for name in maps:
        runtime.store.maps.put(name, recipe, datetime.now(UTC))
    for floor, spot, image in one.enrolments():
        attributes = ViewAttributes(place=f"{floor}/{spot}")
        name = maps[floor - 1] if apart else whole
        runtime.services.enroll.enroll(encoded(image), name, attributes, patience_s=PATIENCE_S)
    runtime.comparer.all()  # as the service does in the background
    return _answers(runtime, maps, one.queries(count)), _answers(runtime, maps, one.unknown(count))


def _answers(runtime: Runtime, maps: Sequence[str], shots: Iterable[Shot]) -> list[Answered]:
    answers = []
    for floor, spot, image in shots:
        result = runtime.services.query.query(encoded(image), *maps)
        place = result.results.views[0].view.attributes.place or "0/0"
        first = (int(place.split("/")[0]), int(place.split("/")[1]))
        answers.append(Answered((floor, spot), first, result.decision.status))
    return answers


def encoded(image: Pixels) -> bytes:
    """A drawing as JPEG."""
    done, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise ValueError("an image could not be encoded")
    return bytes(data)


def table(rows: Sequence[tuple[str, Sequence[Answered]]]) -> str:
    """Markdown: of each row's queries, how many were right, and the verdicts on right and on wrong answers."""
    lines = [
        "| building | queries | right floor | right spot | right: matched, ambiguous, no_match | wrong: the same |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, answers in rows:
        right = [a for a in answers if a.right == "spot"]
        wrong = [a for a in answers if a.right != "spot"]
        verdicts = [Counter(a.verdict for a in some) for some in (right, wrong)]
        told = [", ".join(str(counted[v]) for v in VERDICTS) for counted in verdicts]
        floors = sum(a.right != "no" for a in answers)
        lines.append(f"| {name} | {len(answers)} | {floors} | {len(right)} | {told[0]} | {told[1]} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command-line entry point."""
    parser = argparse.ArgumentParser(prog="python -m lab.benchmarks.floors", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--kinds", nargs="+", choices=sorted(KINDS), default=sorted(KINDS))
    parser.add_argument("--floors", type=int, default=4)
    parser.add_argument("--spots", type=int, default=6)
    parser.add_argument("--queries", type=int, default=1, help="of each spot")
    parser.add_argument("--apart", action="store_true", help="a map for each floor, all queried together")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--encoder", default="compact")
    options = parser.parse_args(arguments)
    rows: list[tuple[str, Sequence[Answered]]] = []
    with runtime_for_measuring(Settings(encoder=options.encoder)) as runtime:
        for kind in options.kinds:
            for seed in options.seeds:
                one = building(seed, options.floors, options.spots, kind)
                enrolled, unknown = measured(runtime, options.preset, one, options.queries, apart=options.apart)
                rows += [(f"{kind} {seed}", enrolled), (f"{kind} {seed}, floor never enrolled", unknown)]
                print(f"{kind} {seed} done", file=sys.stderr, flush=True)
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
