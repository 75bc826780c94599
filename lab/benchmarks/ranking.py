"""recall@1 of each step of the ranking, on folders of images with a table of right answers.

    python -m lab.benchmarks.ranking --places DIR --general DIR [--general DIR ...] [--part 0.5]

`--places` as `lab.datasets.pairs` reads it; `--general` holds images of other places, from which the vocabulary is
learned. Every list of candidates is the one before it, re-ordered.
"""

import argparse
import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lab.datasets import pairs
from lab.datasets.dataset import ENDINGS, Dataset
from lab.evaluation.in_process import runtime_for_measuring, train_vocabulary
from lab.evaluation.service import map_of_its_own
from lab.metrics.recall import bootstrap_interval
from schemas.description import Description
from schemas.errors import NothingStatic
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe
from schemas.records import Filters, Position
from schemas.settings import Settings
from worker.description.presets import Wanted, changed_ranking, make_recipe
from worker.method.evidence import Evidence
from worker.runtime import Runtime

PRESET = "default"


def best(evidence: Evidence) -> int:
    """Sequence number of the view that is first by what is known so far."""
    return evidence.seqs(evidence.best(1))[0]


def nearest(channel: str, evidence: Evidence) -> int:
    """Sequence number of the view that a channel's search found first."""
    return int(evidence.candidates.seqs[np.argmax(evidence.candidates.ranks[channel] == 1)])


@dataclass(frozen=True)
class Step:
    """A moment of the ranking.

    Parameters
    ----------
    name : str
        In the table.
    stage : str
        Of `worker.method.cascade.STAGES`: looked at when this one is over.
    changes : mapping
        Of the map's ranking, for steps that are finer than a stage.
    first : function
        From what is known to the first view's sequence number.
    """

    name: str
    stage: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    first: Callable[[Evidence], int] = best


def steps(channels: Sequence[str]) -> list[Step]:
    """All steps, in the order of the ranking."""
    without_graph, joined, any_scale = {"weights": {"graph": 0.0}}, {"detail_only_top_k": 0}, {"scale_penalty": 0.0}
    return [
        *(Step(f"histogram of {name}", "histograms", first=partial(nearest, name)) for name in channels),
        Step("cells at half size", "coarse", without_graph | joined),
        Step("and of detail only", "coarse", without_graph),
        Step("and the context graph", "coarse"),
        Step("joined cells in full, at any scale", "full", joined | any_scale),
        Step("joined cells in full", "full", joined),
        Step("and of detail only, in full", "full"),
        Step("and keypoints verified", "verification"),
    ]


def measure(dataset: Dataset, runtime: Runtime, recipe: MapRecipe, part: float) -> dict[str, list[bool]]:
    """For each step, whether its first answer to each query that has one is right.

    Parameters
    ----------
    dataset : Dataset
    runtime : Runtime
        Started.
    recipe : MapRecipe
    part : float
        Share of the queries, 0..1.
    """
    queries = np.flatnonzero(dataset.judged().answerable)[:: max(1, round(1 / part))].tolist()
    found: dict[str, list[bool]] = {}
    with map_of_its_own(runtime, recipe, PRESET, dataset) as retriever:
        numbers: dict[int, list[int]] = {}
        for number, path in enumerate(dataset.database):
            with suppress(NothingStatic):
                view = runtime.store.views.get(retriever.enroll(path, Position()))
                numbers.setdefault(view.seq, []).append(number)
        described = _described(runtime, retriever.map_name, {query: dataset.queries[query] for query in queries})
        for step in steps(list(recipe.description.parameters.channels)):
            first = _first_views(runtime, retriever.map_name, recipe, described, step)
            answers = {query: numbers[seq] for query, seq in first.items()}
            found[step.name] = [bool(np.isin(answers.get(q, ()), dataset.positives[q]).any()) for q in queries]
    return found


def _described(runtime: Runtime, map_name: str, queries: Mapping[int, Path]) -> dict[int, Description]:
    """Descriptions of queries; one in which everything is dynamic is left out."""
    service = runtime.services.searcher
    describer = service.describer(map_name)
    described = {}
    for query, path in queries.items():
        with suppress(NothingStatic):
            described[query] = service.describe(runtime.decode(path.read_bytes()), describer).value
    return described


def _first_views(
    runtime: Runtime, map_name: str, recipe: MapRecipe, described: Mapping[int, Description], step: Step
) -> dict[int, int]:
    """Sequence numbers of the views that are first after a step, by query."""
    ranking = changed_ranking(recipe, step.changes)
    runtime.store.maps.change(map_name, MapChanges(ranking=lambda _: ranking))
    seen: list[int] = []

    def observe(stage: str, evidence: Evidence) -> None:
        if stage == step.stage:
            seen.append(step.first(evidence))

    first = {}
    for query, description in described.items():
        runtime.services.searcher.search({map_name: Filters()}, recipe.description, description, top=1, observe=observe)
        first[query] = seen[-1]
    return first


def _general(folders: Sequence[Path], count: int) -> list[Path]:
    paths = sorted(p for folder in folders for p in folder.rglob("*") if p.suffix.lower() in ENDINGS)
    drawn = np.random.default_rng(0).permutation(len(paths))[:count]
    return [paths[i] for i in sorted(drawn)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="revisit benchmark ranking", description="recall@1 of each step of ranking")
    parser.add_argument("--places", type=Path, required=True)
    parser.add_argument("--general", type=Path, required=True, action="append")
    parser.add_argument("--learn", type=int, default=600, help="how many general images are read")
    parser.add_argument("--part", type=float, default=1.0, help="share of the queries that are made")
    parser.add_argument("--only", action="append", default=[], help="sets whose name contains this")
    options = parser.parse_args(arguments)
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "onnxruntime", "opencv-python-headless"))
    print(f"{datetime.now(UTC):%Y-%m-%d}, one thread, {libraries}, Python {platform.python_version()}\n")
    datasets = pairs.read(options.places)
    with runtime_for_measuring(Settings(encoder="compact", threads=1)) as runtime:
        plain = make_recipe(runtime.encoder, Wanted(), preset=PRESET).description
        learned = train_vocabulary(
            runtime, _general(options.general, options.learn), runtime.describers.of(plain), plain.parameters
        )
        recipe = make_recipe(runtime.encoder, Wanted(), preset=PRESET, vocabulary=learned)
        for dataset in datasets:
            if options.only and not any(text in dataset.name for text in options.only):
                continue
            print(f"{dataset.name}: recall@1 in %, 95 % interval by resampling runs of 5 queries")
            for step, right in measure(dataset, runtime, recipe, options.part).items():
                values = np.array(right, np.float64)[:, None]
                low, high = bootstrap_interval(values, np.random.default_rng(0), block=5)
                print(f"  {step:36s} {100 * values.mean():5.1f}  ({100 * low[0]:.0f}-{100 * high[0]:.0f})", flush=True)


if __name__ == "__main__":
    main()
