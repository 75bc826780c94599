"""What other local features, other verification and a learned rule would make of the first ten answers.

    python -m lab.benchmarks.geometry --data DIR --cache FILE [--only SET] [--out FILE]

DIR holds ``places`` as `lab.datasets.pairs` reads it, FILE the descriptions that ``lab.benchmarks.scale describe`` made
of it. The first ten are those that the service verifies. Each variant counts inliers anew; each rule orders the ten by
them and by the score without verification.
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from lab.baselines.two_views import fundamental
from lab.datasets import pairs
from lab.datasets.dataset import Dataset
from lab.libraries import FOR_FITTING, for_studies, require
from lab.scale.cache import Cache
from lab.scale.measuring import EVERYTHING
from lab.scale.pool import Pool, PoolFetch, placed, query_of
from schemas.description import Booleans, Doubles, Floats, LocalFeatures
from schemas.image import Bytes2D
from schemas.recipe import MapRecipe
from schemas.records import Changes
from schemas.settings import Settings
from worker.configure import configure
from worker.description import local_features
from worker.description.presets import PRESETS, Wanted, make_recipe
from worker.encoders.choosing import make_encoder
from worker.images import codec
from worker.images.codec import Limits
from worker.method import cascade, score_fusion, verification
from worker.method.byte_vectors import Product
from worker.method.evidence import Evidence
from worker.search.byte_product import make_product
from worker.search.flat_index import FlatIndex

CELLS = 4
"""Rows and columns of the grid over the query in which the spread of inliers is counted."""

TEN = 10
"""Candidates that the service verifies."""

SHIPPED = PRESETS["default"].ranking.weights.verification
"""Weight of verification in the default preset."""

SOFT = 12.0
"""Inliers and matches added before quotients, so that a few over none are weak evidence."""


@dataclass(frozen=True)
class Features:
    """Local features.

    Parameters
    ----------
    keypoints : int
    most : int
        Largest longer side, pixels. Smaller images are read at their own size, or enlarged to `LONGER_SIDE`.
    upright, equalised : bool
        As of `local_features.root_descriptors`.
    """

    keypoints: int
    most: int
    upright: bool = False
    equalised: bool = False

    def of(self, pixels: Bytes2D) -> LocalFeatures:
        """Features of an image, uint8 (height, width, 3)."""
        side = int(np.clip(max(pixels.shape[:2]), local_features.LONGER_SIDE, self.most))
        positions, descriptors = local_features.root_descriptors(
            pixels, self.keypoints, side, self.upright, self.equalised
        )
        return LocalFeatures(positions, local_features.reduce(descriptors))


def affine(source: Floats, target: Floats) -> Booleans:
    """Inliers of the affine transform that the service finds."""
    return verification.consensus(source, target)[1]


VARIANTS: Mapping[str, tuple[Features, Callable[[Floats, Floats], Booleans]]] = {
    "300 at 320, affine": (Features(300, 320), affine),
    "300 at 320 equalised, affine": (Features(300, 320, equalised=True), affine),
    "300 at 320, fundamental": (Features(300, 320), fundamental),
    "300 at 320 upright, affine": (Features(300, 320, upright=True), affine),
    "300 at 320 upright, fundamental": (Features(300, 320, upright=True), fundamental),
    "600 at 480, affine": (Features(600, 480), affine),
    "800 at 640, affine": (Features(800, 640), affine),
    "800 at 640 equalised, affine": (Features(800, 640, equalised=True), affine),
    "800 at 640, fundamental": (Features(800, 640), fundamental),
    "800 at 640 upright, fundamental": (Features(800, 640, upright=True), fundamental),
}


@dataclass(frozen=True, eq=False)
class TopTen:
    """One query.

    Parameters
    ----------
    base : float64 of shape (candidates,)
        Score without verification, before division by the sum of weights.
    right : bool of shape (candidates,)
    counted : mapping of variant to float64 of shape (candidates, 3)
        Inliers, matches, and the share of the query's `CELLS` x `CELLS` cells that hold an inlier.
    """

    base: Doubles
    right: Booleans
    counted: Mapping[str, Doubles]


def top_tens(dataset: Dataset, root: Path, pool: Pool, recipe: MapRecipe, product: Product) -> list[TopTen]:
    """The first ten of every query of a set, verified by every variant."""
    one = placed(dataset, root, pool)
    if one is None:
        return []
    seqs = np.sort(np.random.default_rng(0).permutation(one.database)).astype(np.int64) + 1
    described = recipe.description
    index = FlatIndex({name: c.length for name, c in described.parameters.channels.items()}, described.id)
    index.apply(Changes(1, described.id, seqs, pool.vectors[seqs - 1], np.zeros(0, np.int64)))
    weights = {name: w for name, w in recipe.ranking.weights.terms().items() if name != "verification"}
    tens, found = [], cache(partial(_found, root, pool))
    for row, right in zip(one.queries.tolist(), one.right, strict=True):
        seen: list[Evidence] = []
        query = query_of(pool, row, described)
        near = index.search(query.vectors, recipe.ranking.searched, EVERYTHING)
        cascade.rank(
            query,
            near,
            described,
            recipe.ranking,
            PoolFetch(pool),
            top=1,
            product=product,
            observe=partial(_keep, seen),
        )
        [evidence] = seen
        first = np.array(sorted(evidence.verified), np.intp)
        score, _ = score_fusion.weigh(evidence.terms, weights)
        rows = [seq - 1 for seq in evidence.seqs(first)]
        counted = {name: _counted(name, row, rows, found) for name in VARIANTS}
        base = score[first].astype(np.float64) * sum(weights.values())
        tens.append(TopTen(base, np.isin(rows, right), counted))
    return tens


def _keep(seen: list[Evidence], stage: str, evidence: Evidence) -> None:
    if stage == "verification":
        seen.append(evidence)


def _found(root: Path, pool: Pool, features: Features, row: int) -> LocalFeatures:
    return features.of(codec.decode((root / pool.keys[row]).read_bytes(), Limits()).pixels)


def _counted(name: str, query: int, views: Sequence[int], found: Callable[[Features, int], LocalFeatures]) -> Doubles:
    features, consensus = VARIANTS[name]
    ours, theirs = found(features, query), [found(features, view) for view in views]
    rows = []
    for view, matched in zip(
        theirs, verification.match(ours.descriptors, [v.descriptors for v in theirs]), strict=True
    ):
        source, target = ours.positions[matched[:, 0]], view.positions[matched[:, 1]]
        inliers = consensus(source, target)
        cells = np.minimum((source[inliers] * CELLS).astype(int), CELLS - 1)
        rows.append((int(inliers.sum()), len(matched), len(np.unique(cells, axis=0)) / CELLS**2))
    return np.array(rows, np.float64)


def evidence_of(ten: TopTen, variant: str) -> Doubles:
    """What the learned rule reads, float64 (candidates, 4); all of it rises with the evidence.

    Score without verification (less the best's), logarithm of inliers over the median of the ten, share of the matches
    that are inliers, spread.
    """
    inliers, matches, spread = ten.counted[variant].T
    ratio = np.log((inliers + SOFT) / (np.median(inliers) + SOFT))
    return np.stack([ten.base - ten.base.max(), np.maximum(ratio, 0), inliers / (matches + SOFT), spread], axis=1)


def learn(queries: Sequence[Sequence[TopTen]], variant: str) -> Doubles:
    """Weights of `evidence_of`, none below 0: conditional logistic regression, every set counting the same."""
    with for_studies():
        from scipy.optimize import minimize  # type: ignore[import-untyped]
    cases = [
        (evidence_of(one, variant), one.right, 1 / len(some))
        for some in queries
        for one in some
        if one.right.any() and not one.right.all()
    ]

    def loss(weights: Doubles) -> tuple[float, Doubles]:
        total, slope = 1e-4 * float(weights @ weights), 2e-4 * weights
        for read, right, share in cases:
            odds = np.exp(read @ weights - (read @ weights).max())
            all_odds, good = odds.sum(), np.where(right, odds, 0)
            total += share * float(np.log(all_odds) - np.log(max(good.sum(), 1e-300)))
            slope = slope + share * (odds / all_odds - good / max(good.sum(), 1e-300)) @ read
        return total, slope

    start = np.array([20.0, 1, 1, 1])
    found = minimize(loss, start, method="L-BFGS-B", jac=True, bounds=[(0, None)] * 4)
    return np.asarray(found.x, np.float64)


def first_right(queries: Sequence[TopTen], value: Callable[[TopTen], Doubles]) -> Booleans:
    """Whether the first answer is right, bool (queries,); ties go to the better score, then to the earlier enrolled."""
    return np.array([one.right[np.lexsort((-one.base, -value(one)))[0]] for one in queries], np.bool_)


def separation(queries: Sequence[TopTen], variant: str) -> float:
    """Area under the curve of inliers, right candidates against wrong ones of the same query; ties count half."""
    areas = []
    for one in queries:
        inliers = one.counted[variant][:, 0]
        if one.right.any() and not one.right.all():
            apart = np.subtract.outer(inliers[one.right], inliers[~one.right])
            areas.append(float(((apart > 0) + 0.5 * (apart == 0)).mean()))
    return float(np.mean(areas)) if areas else float("nan")


def gated(variant: str, weight: float) -> Callable[[TopTen], Doubles]:
    """The service's rule: weight times the bonus over the median."""
    return lambda one: one.base + weight * verification.gated_bonus(one.counted[variant][:, 0])


def linear(variant: str, weights: Doubles) -> Callable[[TopTen], Doubles]:
    """The learned rule."""
    return lambda one: evidence_of(one, variant) @ weights


def tables(results: Mapping[str, Sequence[TopTen]]) -> None:
    """recall@1 of every rule and variant, queries won and lost against the service, how well inliers alone separate."""
    names = list(results)
    shipped = {name: first_right(results[name], gated(next(iter(VARIANTS)), SHIPPED)) for name in names}
    print("\n| queries | " + " | ".join(f"{name} ({len(results[name])})" for name in names) + " | mean |")
    print("|" + " --- |" * (len(names) + 2))

    def row(title: str, cells: Sequence[float]) -> None:
        values = [f"{100 * cell:.1f}" for cell in [*cells, float(np.nanmean(cells))]]
        print(f"| {title} | " + " | ".join(values) + " |", flush=True)

    def compare(title: str, found: Mapping[str, Booleans]) -> None:
        won = sum(int((found[name] & ~shipped[name]).sum()) for name in names)
        lost = sum(int((~found[name] & shipped[name]).sum()) for name in names)
        row(f"{title} (+{won} -{lost})", [float(found[name].mean()) for name in names])

    row("among the ten", [float(np.mean([one.right.any() for one in results[n]])) for n in names])
    row("without verification", [float(first_right(results[n], lambda one: one.base).mean()) for n in names])
    for variant in VARIANTS:
        row(f"{variant}: inliers right over wrong", [separation(results[n], variant) for n in names])
        for weight in (SHIPPED, 0.6, 1.0):
            compare(
                f"{variant}: bonus x {weight:g}",
                {name: first_right(results[name], gated(variant, weight)) for name in names},
            )
        learned = {}
        for name in names:
            others = [results[other] for other in names if other.split()[0] != name.split()[0]]
            learned[name] = first_right(results[name], linear(variant, learn(others, variant)))
        compare(f"{variant}: learned, site left out", learned)
        print(f"<!-- learned from all: {np.round(learn(list(results.values()), variant), 2).tolist()} -->")


def cost(paths: Sequence[Path]) -> None:
    """CPU time of each variant, median over images: features of one image, and verification of ten."""
    images = [codec.decode(path.read_bytes(), Limits()).pixels for path in paths]
    print(
        "\n| variant | features, ms | ten verified, ms | bytes a view, before packing |\n" + "| --- | --- | --- | --- |"
    )
    for variant, (features, _) in VARIANTS.items():
        described, verified, found = [], [], []
        for pixels in images:
            began = time.process_time()
            found.append(features.of(pixels))
            described.append(1000 * (time.process_time() - began))
        for row in range(len(found)):
            ten = [(row + 1 + step) % len(found) for step in range(TEN)]
            began = time.process_time()
            _counted(variant, row, ten, partial(_nth, found))
            verified.append(1000 * (time.process_time() - began))
        size = np.mean([len(one) * (2 * 2 + one.descriptors.shape[1]) for one in found])
        print(f"| {variant} | {np.median(described):.0f} | {np.median(verified):.1f} | {size:.0f} |", flush=True)


def _nth(found: Sequence[LocalFeatures], features: Features, row: int) -> LocalFeatures:
    return found[row]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="revisit benchmark geometry", description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--encoder", choices=("compact", "color"), default="compact")
    parser.add_argument("--only", action="append", default=[], help="sets whose name contains this")
    parser.add_argument("--out", type=Path, help="JSON file: counts are kept in it set by set, and read where they are")
    options = parser.parse_args(arguments)
    require(FOR_FITTING)
    configure(1)
    settings = Settings(encoder=options.encoder, threads=1)
    encoder, _ = make_encoder(settings, 1)
    product = make_product(settings)
    recipe = make_recipe(encoder, Wanted(), preset="default")
    pool = Pool.of(Cache(options.cache, recipe.description))
    results = _read(options.out)
    for dataset in pairs.read(options.data / "places"):
        wanted = any(text in dataset.name for text in options.only or [""])
        if wanted and dataset.name not in results:
            began = time.monotonic()
            tens = top_tens(dataset, options.data, pool, recipe, product)
            print(f"{dataset.name}: {len(tens)} queries, {time.monotonic() - began:.0f} s", flush=True)
            if tens:
                results[dataset.name] = tens
                _write(options.out, results)
    tables(results)
    cost(sorted((options.data / "places").rglob("*.jpg"))[::40])


def _read(path: Path | None) -> dict[str, list[TopTen]]:
    if path is None or not path.is_file():
        return {}
    return {
        name: [
            TopTen(np.array(o["base"]), np.array(o["right"]), {v: np.array(c) for v, c in o["counted"].items()})
            for o in tens
        ]
        for name, tens in json.loads(path.read_text()).items()
    }


def _write(path: Path | None, results: Mapping[str, Sequence[TopTen]]) -> None:
    if path is not None:
        plain = {
            name: [
                {
                    "base": o.base.tolist(),
                    "right": o.right.tolist(),
                    "counted": {v: c.tolist() for v, c in o.counted.items()},
                }
                for o in tens
            ]
            for name, tens in results.items()
        }
        path.write_text(json.dumps(plain))


if __name__ == "__main__":
    main()
