"""recall@1 of each step of re-ranking, on folders of pictures with a table of right answers.

    python -m lab.benchmarks.ranking --places DIR --general DIR [--general DIR ...] [--part 0.5]

`--places` as `lab.datasets.pairs` reads it; `--general` holds pictures of other places, from which words and
projections are learned. Every candidate list is the one before it, re-ordered.
"""

import argparse
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import torch

from lab.datasets import pairs
from lab.datasets.dataset import ENDINGS, Dataset
from lab.metrics.recall import bootstrap_interval
from schemas.description import Floats, Int8s, LocalFeatures, PixelField
from schemas.image import Image
from schemas.recipe import DenseCells
from worker.description import vocabularies
from worker.description.local_features import local_features
from worker.description.presets import PRESETS
from worker.encoders.compact.encoder import CompactEncoder
from worker.method import channel_fusion, dense_cells, hough, score_fusion, verification, vocabulary
from worker.method.byte_vectors import quantise
from worker.method.hough import Doubles
from worker.method.score_fusion import Rows

PARAMETERS = PRESETS["default"].parameters


@dataclass(frozen=True, eq=False)
class Described:
    """What re-ranking reads of a picture."""

    vectors: Mapping[str, Floats]
    cells: Int8s
    extent: tuple[float, float]
    keypoints: LocalFeatures


class Describer:
    """Pictures to descriptions, each picture once.

    Parameters
    ----------
    general : sequence of Path
    """

    def __init__(self, general: Sequence[Path]) -> None:
        self._encoder = CompactEncoder()
        self._known: dict[Path, Described] = {}
        fields = (self._field(path) for path in general)
        self._vocabulary = vocabularies.train(fields, lambda f: np.ones(f.shape, np.bool_), PARAMETERS)

    def __call__(self, path: Path) -> Described:
        """The description of a picture file."""
        if path not in self._known:
            self._known[path] = self._describe(path)
        return self._known[path]

    def _field(self, path: Path) -> PixelField:
        return next(iter(self._encoder.encode([_image(path)])))

    def _describe(self, path: Path) -> Described:
        field, vectors, parts = self._field(path), {}, {}
        for name, channel in PARAMETERS.channels.items():
            layer, learned = field.layers[channel.layer], self._vocabulary.channels[name]
            vectors[name] = vocabulary.vector(layer.reshape(-1, layer.shape[2]), learned, channel)
            if PARAMETERS.dense is not None and learned.cells is not None:
                grid = dense_cells.grid(layer, PARAMETERS.dense.rows, PARAMETERS.dense.columns)
                parts[name] = dense_cells.reduce(grid, learned.cells)
        cells = quantise(dense_cells.join(parts, PARAMETERS.dense.shares if PARAMETERS.dense else {}))
        wanted = PARAMETERS.verification.keypoints if PARAMETERS.verification else 0
        return Described(vectors, cells, field.extent, local_features(_image(path).pixels, wanted))


def steps(query: Described, database: Sequence[Described], weights: Mapping[str, float]) -> Iterator[tuple[str, int]]:
    """Name of each step, and the database picture it ranks first."""
    terms: dict[str, Floats] = {}
    everyone = np.arange(len(database))
    chosen = np.zeros(len(database), np.bool_)
    total = np.zeros(len(database), np.float32)
    for name, channel in PARAMETERS.channels.items():
        distance = np.linalg.norm(np.stack([d.vectors[name] for d in database]) - query.vectors[name], axis=1)
        total += distance.astype(np.float32)
        chosen[np.argsort(distance, kind="stable")[: PARAMETERS.candidates]] = True
        terms[f"histogram.{name}"] = score_fusion.histogram_similarity(distance.astype(np.float32), channel)
        yield f"histogram of {name}", int(distance.argmin())
    rows = everyone[chosen]

    def best(count: int) -> Rows:
        score, _ = score_fusion.weigh(terms, weights)
        return score_fusion.order(score, total, rows)[:count]

    def put(term: str, where: Rows, values: Floats) -> None:
        terms[term] = np.zeros(len(database), np.float32)
        terms[term][where] = values

    def cell_aspect(where: Rows) -> Doubles:
        return hough.cell_aspects(query.extent, [database[int(row)].extent for row in where])

    ours, *theirs = (quantise(dense_cells.halve(d.cells)) for d in (query, *(database[r] for r in rows)))
    halves, dense = np.stack(theirs), PARAMETERS.dense or DenseCells(full_resolution_top_k=0)
    alike = dense_cells.compare(ours, halves, cell_aspect=cell_aspect(rows)).scores
    put("dense", rows, alike)
    yield "cells at half size", int(best(1)[0])
    rates, scores = {}, alike
    for part in dense.read_alone:
        alone = channel_fusion.alone(ours, halves, PARAMETERS.joined(), part, cell_aspect=cell_aspect(rows))
        rates[part] = channel_fusion.align_scale(alike, alone)
        scores = channel_fusion.max_fusion(scores, alone, rates[part])
    put("dense", rows, scores)
    yield "and channels alone", int(best(1)[0])
    first = best(dense.full_resolution_top_k)
    cells = np.stack([database[int(row)].cells for row in first])
    alike_in_full = dense_cells.compare(query.cells, cells, cell_aspect=cell_aspect(first))
    put("close", first, alike_in_full.scores)
    yield "joined cells in full, at any scale", int(best(1)[0])
    near = dense_cells.nearness(alike_in_full.scales, dense.scale_penalty)
    put("close", first, alike_in_full.scores * near)
    yield "joined cells in full", int(best(1)[0])
    scores = alike_in_full.scores
    for part, full_resolution_top_k in dense.read_alone.items():
        some = (cells[:full_resolution_top_k], PARAMETERS.joined(), part)
        alone = channel_fusion.alone(query.cells, *some, cell_aspect=cell_aspect(first[:full_resolution_top_k]))
        scores = channel_fusion.max_fusion(scores, alone, rates[part])
    put("close", first, scores * near)
    yield "and channels alone in full", int(best(1)[0])
    first = best(PARAMETERS.verification.candidates if PARAMETERS.verification else 0)
    verified = verification.verify(query.keypoints, [database[int(row)].keypoints for row in first])
    put("verification", first, verification.gated_bonus([view.inliers for view in verified]))
    yield "and keypoints verified", int(best(1)[0])


def measure(dataset: Dataset, describe: Describer, part: float) -> dict[str, list[bool]]:
    """For each step, whether its first answer to each query that has one is right."""
    database = [describe(path) for path in dataset.database]
    results = [i for i, right in enumerate(dataset.positives) if len(right)]
    results = results[:: max(1, round(1 / part))]
    found: dict[str, list[bool]] = {}
    for i in results:
        for step, answer in steps(describe(dataset.queries[i]), database, PARAMETERS.weights):
            found.setdefault(step, []).append(answer in dataset.positives[i])
    return found


def _image(path: Path) -> Image:
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise SystemExit(f"{path} is not a picture that OpenCV reads")
    return Image.of(np.asarray(pixels, np.uint8))


def _general(folders: Sequence[Path], count: int) -> list[Path]:
    paths = sorted(p for folder in folders for p in folder.rglob("*") if p.suffix.lower() in ENDINGS)
    drawn = np.random.default_rng(0).permutation(len(paths))[:count]
    return [paths[i] for i in sorted(drawn)]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="recall@1 of each step of re-ranking")
    parser.add_argument("--places", type=Path, required=True)
    parser.add_argument("--general", type=Path, required=True, action="append")
    parser.add_argument("--learn", type=int, default=600, help="how many general pictures are read")
    parser.add_argument("--part", type=float, default=1.0, help="share of the queries that are asked")
    parser.add_argument("--only", action="append", default=[], help="sets whose name contains this")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    print(f"{datetime.now(UTC):%Y-%m-%d}, one thread, numpy {np.__version__}, torch {torch.__version__},", end=" ")
    print(f"OpenCV {cv2.__version__}, Python {platform.python_version()}\n")
    describe = Describer(_general(arguments.general, arguments.learn))
    for dataset in pairs.read(arguments.places):
        if arguments.only and not any(text in dataset.name for text in arguments.only):
            continue
        print(f"{dataset.name}: recall@1 in %, 95 % interval by resampling runs of 5 queries")
        for step, right in measure(dataset, describe, arguments.part).items():
            values = np.array(right, np.float64)[:, None]
            low, high = bootstrap_interval(values, np.random.default_rng(0), block=5)
            print(f"  {step:36s} {100 * values.mean():5.1f}  ({100 * low[0]:.0f}-{100 * high[0]:.0f})", flush=True)


if __name__ == "__main__":
    main()
