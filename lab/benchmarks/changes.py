"""What is found gone, new and moved: ``./revisit benchmark changes [--places N] [--root DIR SET:FOLDER ...]``.

Drawn places are refurnished, so that what changed is known. Of sets of photos it is told how much is found to have
changed: in a place where nothing was moved each of these is wrong.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from lab.datasets.dataset import rows_of
from lab.evaluation.in_process import runtime_for_measuring
from scenes.geometry import Pixels
from scenes.refurnishing import FURNITURE, Piece, furnished
from scenes.scene import Lighting, Scene, scene
from schemas.description import Booleans
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.settings import Settings
from worker.method.changes import Changes
from worker.runtime import Runtime

EXPECTED = "  DIR/SET/ground_truth.csv   columns query_folder,query_file,database_folder,database_file"
COLUMNS = ("query_folder", "query_file", "database_folder", "database_file")
SEEN = 0.008
"""Share of an image from which a piece of furniture counts."""

FOUND = 0.3
"""Intersection over union from which a region is a piece of furniture."""

WHEN = ("then", "now")

LIGHTS: tuple[Lighting, ...] = ("noon", "overcast", "dusk")


@dataclass(frozen=True, eq=False)
class Truth:
    """A piece that changed: how, and where it is seen, uint8 (height, width); None where it is not."""

    kind: Literal["gone", "new", "moved"]
    then: Pixels | None
    now: Pixels | None


@dataclass
class Tally:
    """Counts over pairs; of sites, one for each photo in which a changed piece is seen."""

    pairs: int = 0
    aligned: int = 0
    told: int = 0
    sites: int = 0
    right: int = 0
    wrong: int = 0
    moved: int = 0
    moved_found: int = 0
    kinds: dict[str, int] = field(default_factory=dict)

    @property
    def precision(self) -> float:
        """Share of the regions told that are pieces that changed; parts of pieces count as neither."""
        return self.right / max(1, self.right + self.wrong)

    @property
    def recall(self) -> float:
        """Share of the sites that are told."""
        return self.right / max(1, self.sites)


def refurnished(seed: int) -> tuple[Pixels, Pixels, list[Truth]]:
    """A drawn place then and now, seen from another spot in other light, with what changed."""
    rng = np.random.default_rng([11, seed])
    place = scene(f"{('corridor', 'street', 'park', 'corridor')[seed % 4]} refurnished {seed}")

    def piece() -> Piece:
        ahead = float(rng.uniform(2.6, 6))
        kind = FURNITURE[rng.integers(len(FURNITURE))]
        return Piece(kind, float(rng.uniform(-0.55, 0.55)) * ahead, ahead, int(rng.integers(1_000_000)))

    then = [piece() for _ in range(int(rng.integers(2, 5)))]
    now, what = list(then), {("gone", "new", "moved", "none")[rng.integers(4)] for _ in range(2)}
    if "gone" in what:
        now.remove(then[0])
    if "new" in what:
        now.append(piece())
    if "moved" in what:
        aside = 1.3 if then[1].across < 0 else -1.3
        now[now.index(then[1])] = then[1].moved(aside, float(rng.uniform(-0.3, 0.3)))
    before, masks = furnished(place, then)
    after, later = furnished(_again(place, rng), now)
    seen = dict(zip(now, later, strict=True))
    truth = []
    for one, mask in zip(then, masks, strict=True):
        if one not in now:
            other = next((two for two in now if (two.kind, two.seed) == (one.kind, one.seed)), None)
            truth.append(Truth("gone", mask, None) if other is None else Truth("moved", mask, seen[other]))
    known = {one.seed for one in then}
    truth += [Truth("new", None, seen[one]) for one in now if one.seed not in known]
    return before, after, truth


def _again(place: Scene, rng: np.random.Generator) -> Scene:
    """The place from a step aside, in other light; sometimes somebody stands there."""
    dx, ahead, turn = rng.uniform(-0.25, 0.25), rng.uniform(-0.3, 0.3), rng.uniform(-4, 4)
    seen = place.at(LIGHTS[rng.integers(3)]).seen_from(dx=float(dx), ahead=float(ahead), turn=float(turn))
    return seen.behind("person") if rng.random() < 0.2 else seen


def judge(found: Changes | None, truth: Sequence[Truth], tally: Tally) -> None:
    """Count what was found of a pair."""
    tally.pairs += 1
    sites = [(when, mask > 0) for one in truth for when in WHEN if (mask := seen(one, when)) is not None]
    tally.sites += len(sites)
    moved = [one for one in truth if one.kind == "moved" and all(seen(one, when) is not None for when in WHEN)]
    tally.moved += len(moved)
    if found is None:
        return
    tally.aligned += 1
    tally.told += len(found.changes)
    hit: set[int] = set()
    for change in found.changes:
        tally.kinds[change.kind] = tally.kinds.get(change.kind, 0) + 1
        for when in WHEN:
            spot = getattr(change, when)
            if spot is None:
                continue
            fits = [(overlap(spot.cells, mask), n) for n, (at, mask) in enumerate(sites) if at == when]
            best = max(fits, default=((0.0, 0.0), -1))
            if best[0][0] >= FOUND:
                hit.add(best[1])
            elif all(inside <= 0.5 for (_, inside), _ in fits):
                tally.wrong += 1
        if change.kind == "moved" and change.then is not None and change.now is not None:
            ends = change.then.cells, change.now.cells
            tally.moved_found += any(
                overlap(ends[0], one.then > 0)[0] >= FOUND and overlap(ends[1], one.now > 0)[0] >= FOUND
                for one in moved
                if one.then is not None and one.now is not None
            )
    tally.right += len(hit)


def seen(one: Truth, when: str) -> Pixels | None:
    """Where a piece is seen ``then`` or ``now``, uint8 (height, width); None where it is too little to count."""
    mask: Pixels | None = getattr(one, when)
    return mask if mask is not None and float(mask.mean()) > SEEN else None


def overlap(cells: Booleans, mask: Booleans) -> tuple[float, float]:
    """Intersection over union of a region and a piece, and the share of the region within the piece."""
    size = (mask.shape[1], mask.shape[0])
    region = cv2.resize(cells.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    both = int((region & mask).sum())
    return both / max(1, int((region | mask).sum())), both / max(1, int(region.sum()))


def photos(root: Path, named: str, most: int) -> Iterator[tuple[Image, Image]]:
    """Photos of a set (``SET:FOLDER``) and, of each, the middle one of its right answers: the earlier photo first."""
    name, _, folder = named.partition(":")
    answers: dict[str, list[tuple[str, str]]] = {}
    for row in rows_of(root / name / "ground_truth.csv", COLUMNS, EXPECTED):
        if row["query_folder"] == folder:
            answers.setdefault(row["query_file"], []).append((row["database_folder"], row["database_file"]))
    for query in sorted(answers)[:: max(1, len(answers) // most)][:most]:
        right = answers[query]
        then, now = (root / name / Path(*part) for part in (right[len(right) // 2], (folder, query)))
        yield _read(then), _read(now)


def _read(path: Path) -> Image:
    return Image.of(np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR_RGB), np.uint8))


def measure(runtime: Runtime, pairs: Iterator[tuple[Image, Image, list[Truth]]], recipe: DescriptionRecipe) -> Tally:
    """Compare pairs and count what is found."""
    tally = Tally()
    for then, now, truth in pairs:
        judge(runtime.services.changes.compare(then, now, recipe)[1], truth, tally)
    return tally


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="revisit benchmark changes", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="*", metavar="SET:FOLDER", help="a set of --root, and its folder of later photos")
    parser.add_argument("--root", type=Path)
    parser.add_argument("--places", type=int, default=40, help="drawn places (default: 40)")
    parser.add_argument("--most", type=int, default=24, help="pairs of each set (default: 24)")
    given = parser.parse_args(arguments)
    if given.sets and given.root is None:
        parser.error("sets need --root")
    with runtime_for_measuring(Settings()) as runtime:
        recipe = runtime.default_recipe.description
        if given.places:
            drawn = (refurnished(seed) for seed in range(given.places))
            tally = measure(runtime, ((Image.of(a), Image.of(b), truth) for a, b, truth in drawn), recipe)
            print("| drawn places | aligned | sites changed | recall | precision | moved | told as moved | wrongly |")
            print("|---|---|---|---|---|---|---|---|")
            wrongly = tally.kinds.get("moved", 0) - tally.moved_found
            shares = f"{tally.recall:.2f} | {tally.precision:.2f} | {tally.moved} | {tally.moved_found} | {wrongly}"
            print(f"| {tally.pairs} | {tally.aligned} | {tally.sites} | {shares} |\n")
        if given.sets:
            print("| set | pairs | aligned | changes a pair |\n|---|---|---|---|")
        for named in given.sets:
            tally = measure(runtime, ((*pair, []) for pair in photos(given.root, named, given.most)), recipe)
            print(f"| {named} | {tally.pairs} | {tally.aligned} | {tally.told / max(1, tally.aligned):.2f} |")
