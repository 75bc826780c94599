"""Every set among thousands of views of other sites: candidates and first answers, and a forecast for larger maps.

    python -m lab.benchmarks.scale describe --data DIR     # once; goes on where it was stopped
    python -m lab.benchmarks.scale measure --data DIR      # the tables

DIR holds ``places`` as `lab.datasets.pairs` reads it. Distractors are all other images below DIR, those of the other
sets first among them, then drawn scenes, mirror images and crops. Views of a set's own site are never its distractors.
"""

import argparse
import itertools
import json
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lab.datasets import pairs
from lab.metrics.recall import share_interval
from lab.scale.cache import Cache
from lab.scale.measuring import COUNTS, AtSize, Nearer, measure, nearer
from lab.scale.pool import Placed, Pool, placed
from lab.scale.sources import Source, drawn, originals, varied
from schemas.description import Booleans
from schemas.recipe import MapRecipe
from schemas.settings import Settings
from worker.configure import configure
from worker.description.describer import Describer
from worker.description.ports import Encoder
from worker.description.presets import Wanted, changed_ranking, general_vocabulary, make_recipe
from worker.encoders.choosing import make_encoder
from worker.images import codec
from worker.images.codec import Limits
from worker.search.byte_product import make_product

SIZES = (100, 1_000, 10_000, 20_000)
FORECAST = (100_000, 1_000_000)
CACHE = Path("runs/scale/descriptions.sqlite")
BLOCK = 10
"""Neighbouring queries drawn together for intervals."""


def sources(root: Path, scenes: int) -> Iterator[Source]:
    """All images of the pool, in the order in which they are described."""
    plain = originals(root)
    return itertools.chain(plain, drawn(scenes), varied(plain))


def describe(options: argparse.Namespace, cache: Cache, encoder: Encoder, recipe: MapRecipe) -> None:
    """Fill the cache."""
    words = general_vocabulary(encoder, recipe.ranking.preset)
    describer = Describer(encoder, recipe.description, words, make_product(_settings(options)))
    began = time.monotonic()
    wanted = itertools.islice(sources(options.data, options.scenes), options.views)
    for number in cache.describe(wanted, encoder, describer, partial(codec.decode, limits=Limits())):
        if number % 100 == 0:
            print(f"{number} described in {time.monotonic() - began:.0f} s", flush=True)


def tables(options: argparse.Namespace, cache: Cache, recipe: MapRecipe) -> None:
    """Measure all sets at all sizes, print the tables, and keep the results of each in a file of its own."""
    pool, product = Pool.of(cache), make_product(_settings(options))
    print(f"{len(pool)} views of {len(set(pool.sites.tolist()))} sites")
    results: list[tuple[Placed, list[AtSize], Nearer]] = []
    for dataset in pairs.read(options.data / "places"):
        one = placed(dataset, options.data, pool)
        if one is None or not any(text in dataset.name for text in options.only or [""]):
            continue
        own, most = len(one.database), len(one.database) + len(one.distractors)
        sizes = sorted({own, *(min(size, most) for size in options.sizes if size > own)})
        measured = [measure(one, size, pool, recipe, product) for size in sizes]
        results.append((one, measured, nearer(one, len(one.distractors), pool, recipe)))
        print_set(*results[-1], options.forecast)
    print_pooled(results, options.sizes, options.forecast)
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps([_as_json(*each) for each in results]))


def print_set(one: Placed, measured: Sequence[AtSize], ahead: Nearer, forecast: Sequence[int]) -> None:
    """One row for each size, and one for each forecast."""
    print(f"\n{one.name}: {len(one.queries)} queries, {len(one.database)} views of its own")
    print("   views   " + "   ".join(f"among {count} of each" for count in COUNTS) + "   re-ranked   first")
    for at in measured:
        print(f"{at.views:8d}   {_shares(at.table)}")
    for views in forecast:
        recalls = ahead.forecast(views, len(one.database))
        print(f"{views:8d}   " + "   ".join(f"{recall:.3f}" for recall in recalls) + "   (forecast)")


def print_pooled(
    results: Sequence[tuple[Placed, list[AtSize], Nearer]], sizes: Sequence[int], forecast: Sequence[int]
) -> None:
    """All queries together, each set at the size nearest below that it was measured at: alone, and at each size."""
    print("\nall sets, each query counting the same")
    for size in (0, *sizes):
        at = [next((m for m in reversed(measured) if m.views <= size), measured[0]) for _, measured, _ in results]
        print(f"{size or 'alone':>8}   {_shares(np.concatenate([m.table for m in at]))}")
    weights = np.array([len(one.queries) for one, _, _ in results])
    for views in forecast:
        recalls = np.stack([ahead.forecast(views, len(one.database)) for one, _, ahead in results])
        mean = (recalls * weights[:, None]).sum(axis=0) / weights.sum()
        print(f"{views:8d}   " + "   ".join(f"{recall:.3f}" for recall in mean) + "   (forecast)")


def _shares(found: Booleans) -> str:
    low, high = share_interval(found, np.random.default_rng(0), block=BLOCK)
    return "   ".join(f"{v:.3f} ({a:.3f}-{b:.3f})" for v, a, b in zip(found.mean(axis=0), low, high, strict=True))


def _as_json(one: Placed, measured: Sequence[AtSize], ahead: Nearer) -> dict[str, Any]:
    return {
        "set": one.name,
        "own": len(one.database),
        "sizes": {
            at.views: {"among": at.among.tolist(), "compared": at.compared.tolist(), "first": at.first.tolist()}
            for at in measured
        },
        "nearer": ahead.distractors.tolist(),
        "searched": ahead.searched,
    }


def _settings(options: argparse.Namespace) -> Settings:
    return Settings(encoder=options.encoder, threads=1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Describe, or print the tables."""
    parser = argparse.ArgumentParser(prog="revisit benchmark scale", description="sets among thousands of other views")
    parser.add_argument("action", choices=("describe", "measure"))
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--encoder", choices=("compact", "color"), default="compact")
    parser.add_argument("--views", type=int, default=max(SIZES) + 4000, help="how many images are described")
    parser.add_argument("--scenes", type=int, default=500, help="how many of them are drawn")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--forecast", type=int, nargs="*", default=FORECAST)
    parser.add_argument("--only", action="append", default=[], help="sets whose name contains this")
    parser.add_argument("--ranking", type=json.loads, default={}, help="changes of the ranking, as JSON")
    parser.add_argument("--out", type=Path, help="a JSON file with the result of every query")
    options = parser.parse_args(arguments)
    configure(1)
    encoder, _ = make_encoder(_settings(options), 1)
    recipe = make_recipe(encoder, Wanted(), preset="default")
    recipe = recipe.model_copy(update={"ranking": changed_ranking(recipe, options.ranking)})
    cache = Cache(options.cache, recipe.description)
    if options.action == "describe":
        describe(options, cache, encoder, recipe)
    else:
        tables(options, cache, recipe)


if __name__ == "__main__":
    main()
