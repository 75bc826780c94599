"""The confidence of changes, fitted anew: ``./revisit benchmark fit_changes [--places N]``.

Draws places that are refurnished, other ones than `changes` measures on, finds the regions that one photo of each
lacks, and fits the log-odds that such a region is a piece of furniture that was taken away, put or moved. Prints what
is to stand in worker/method/lost_regions.py, beside what stands there; and how many things would be told as moved at
which similarity. The same places give the same numbers.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lab.benchmarks.changes import FOUND, Truth, overlap, refurnished, seen
from lab.evaluation.in_process import runtime_for_measuring
from lab.fitting import fit_logistic
from schemas.description import Doubles
from schemas.image import Image
from schemas.settings import Settings
from worker.description.describer import components
from worker.method import changes
from worker.method.changes import SAME_THING, Lost
from worker.method.lost_regions import BIAS, WEIGHTS, Region
from worker.runtime import Runtime

FIRST = 1000
"""Number of the first place: `changes` measures on those from 0 on."""

FALLS = ("border",)
"""Features that speak against a change."""

SIMILARITIES = (0.1, 0.15, 0.2, 0.25, 0.3)


@dataclass(frozen=True, eq=False)
class Example:
    """A region, the number of the piece that it shows (None: no piece), and whether that can be told.

    A part of a piece, or a piece with much around it, is neither.
    """

    region: Region
    piece: int | None
    clear: bool


@dataclass(frozen=True, eq=False)
class Pair:
    """Regions of a drawn place then and now, and what changed between them."""

    gone: Sequence[Example]
    new: Sequence[Example]
    truth: Sequence[Truth]
    transform: Doubles
    usual: float


@dataclass(frozen=True)
class Fitted:
    """The log-odds: a weight for each feature of `WEIGHTS`, and what is added."""

    weights: dict[str, float]
    bias: float
    right: int
    wrong: int


def examples(runtime: Runtime, places: Iterable[int]) -> list[Pair]:
    """Regions of drawn places whose photos can be laid over one another."""
    recipe = runtime.default_recipe.description
    found = []
    for place in places:
        then, now, truth = refurnished(place)
        _, both = runtime.services.changes.aligned(Image.of(then), Image.of(now), recipe)
        if both is None:
            continue
        lost = changes.find_lost(both.then, both.now, both.transform, components)
        found.append(
            Pair(_named(lost.gone, "then", truth), _named(lost.new, "now", truth), truth, both.transform, lost.usual)
        )
    return found


def _named(regions: Sequence[Region], when: str, truth: Sequence[Truth]) -> list[Example]:
    masks = [(number, mask > 0) for number, one in enumerate(truth) if (mask := seen(one, when)) is not None]
    named = []
    for region in regions:
        fits = [(*overlap(region.spot.cells, mask), number) for number, mask in masks]
        best = max(fits, default=(0.0, 0.0, -1))
        is_piece = best[0] >= FOUND
        none = all(inside <= 0.5 for _, inside, _ in fits)
        named.append(Example(region, best[2] if is_piece else None, is_piece or none))
    return named


def fit(pairs: Sequence[Pair]) -> Fitted:
    """The least log loss over all regions that can be told; raises ValueError where all are right, or all wrong."""
    told = [one for pair in pairs for one in (*pair.gone, *pair.new) if one.clear]
    sign = np.array([-1.0 if name in FALLS else 1.0 for name in WEIGHTS])
    features = np.array([[one.region.features[name] for name in WEIGHTS] for one in told]) * sign
    right = np.array([one.piece is not None for one in told])
    curve = fit_logistic(features, right)
    weights = curve.weights / curve.scale
    bias = curve.bias - float(weights @ curve.mean)
    return Fitted(
        {name: float(weight) for name, weight in zip(WEIGHTS, weights * sign, strict=True)},
        bias, int(right.sum()), int((~right).sum()),
    )  # fmt: skip


def moved(pairs: Sequence[Pair], similarity: float) -> tuple[int, int]:
    """How many things that moved would be told at a similarity, and how many wrongly."""
    right = wrong = 0
    for pair in pairs:
        pieces = {id(one.region): one.piece for one in (*pair.gone, *pair.new)}
        gone, new = ([one.region for one in some] for some in (pair.gone, pair.new))
        for one, other in changes.moved(Lost(gone, new, 1.0, pair.usual), pair.transform, similarity=similarity):
            piece = pieces[id(one)]
            same = piece is not None and piece == pieces[id(other)] and pair.truth[piece].kind == "moved"
            right, wrong = right + same, wrong + (not same)
    return right, wrong


def moved_pieces(pairs: Sequence[Pair]) -> int:
    """Pieces that moved and are seen in both photos."""
    return sum(
        one.kind == "moved" and seen(one, "then") is not None and seen(one, "now") is not None
        for pair in pairs
        for one in pair.truth
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the fit and the table of what moved."""
    parser = argparse.ArgumentParser(prog="revisit benchmark fit_changes", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--places", type=int, default=160, help="drawn places (default: 160)")
    parser.add_argument("--first", type=int, default=FIRST, help=f"number of the first one (default: {FIRST})")
    given = parser.parse_args(arguments)
    with runtime_for_measuring(Settings()) as runtime:
        pairs = examples(runtime, range(given.first, given.first + given.places))
    fitted = fit(pairs)
    regions = f"{fitted.right} regions that changed and {fitted.wrong} others"
    print(f"{len(pairs)} of {given.places} places aligned, {regions}\n")
    print("| | " + " | ".join(WEIGHTS) + " | bias |\n|---|" + "---|" * (len(WEIGHTS) + 1))
    for name, weights, bias in (("fitted", fitted.weights, fitted.bias), ("shipped", WEIGHTS, BIAS)):
        print(f"| {name} | " + " | ".join(f"{weights[of]:.2f}" for of in WEIGHTS) + f" | {bias:.2f} |")
    print(f"\n{moved_pieces(pairs)} pieces moved; shipped is a similarity of {SAME_THING}\n")
    print("| similarity | told | told wrongly |\n|---|---|---|")
    for similarity in SIMILARITIES:
        right, wrong = moved(pairs, similarity)
        print(f"| {similarity} | {right} | {wrong} |")
