"""Recall at rank 1 on the sets of places: ``python -m training.commands.evaluate_places --network FILE --data DATA``.

Prints, for each pair of folders, what either channel reaches by its histogram, what re-ranking 20 candidates by cells
makes of it, and what both channels reach together.
"""

import argparse
import csv
import json
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import faiss
import numpy as np
import numpy.typing as npt
import torch

from training.commands.export import network_of
from training.data import batches as data
from training.data.images import Image, read_rgb
from training.recognition import DenseCells, Field, Floats, Histograms, best_shift, recall_at_one
from worker.configure import keep_freed_memory
from worker.encoders.compact.network import CompactNetwork

Embed = Callable[[Image], tuple[Field, Field]]
"""A picture (RGB) to its words field and its detail field."""

LONG_SIDE = 480
CHANNELS = ("words", "detail")
TEMPERATURES = (0.05, 0.1)
DENSE_SHARES = (0.8, 0.6)


@dataclass(frozen=True)
class Pair:
    """Queries from one folder, looked up in another."""

    name: str
    place_set: str
    query: str
    database: str


PAIRS = (
    Pair("day", "gardenspoint", "day_left", "day_right"),
    Pair("night", "gardenspoint", "night_right", "day_right"),
    Pair("n-l", "gardenspoint", "night_right", "day_left"),
    Pair("corr", "corridor", "query", "ref"),
    Pair("mon", "months", "query", "database"),
    Pair("pepR", "pepper_repeat", "query", "database"),
    Pair("pepC", "pepper_changed", "query", "database"),
    Pair("nord", "nordland", "query", "database"),
    Pair("essx", "essex_campus", "query", "database"),
)


def embedder(network: CompactNetwork) -> Embed:
    """Wrap the network as a function of one picture."""

    @torch.inference_mode()
    def embed(image: Image) -> tuple[Field, Field]:
        x = torch.from_numpy(resized(image)).permute(2, 0, 1)[None].float() / 255
        words, detail = network(x.contiguous(memory_format=torch.channels_last))
        return _field(words), _field(detail)

    return embed


def resized(image: Image) -> Image:
    """Bring the longer side to 480 pixels, small pictures too, and both sides to multiples of 32."""
    height, width = image.shape[:2]
    scale = LONG_SIDE / max(height, width)
    size = tuple(max(96, round(side * scale / 32) * 32) for side in (width, height))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=how), np.uint8)


def evaluate(embed: Embed, data_folder: Path, pairs: Sequence[Pair] = PAIRS) -> dict[str, list[float]]:
    """Measure one network.

    Returns
    -------
    dict of str to list of float
        For each way of ranking, recall at 1 of each pair, in percent.
    """
    general = _embedded(embed, general_images(data_folder))
    histograms = [Histograms(general[k], temperature=TEMPERATURES[k]) for k in range(2)]
    dense = [DenseCells(general[k]) for k in range(2)]
    del general
    vectors: dict[tuple[str, str], list[Floats]] = {}
    cells: dict[tuple[str, str], list[Floats]] = {}
    for pair in pairs:
        for folder in (pair.query, pair.database):
            key = (pair.place_set, folder)
            if key not in vectors:
                fields = _embedded(embed, place_images(data_folder, *key))
                vectors[key] = [histograms[k].of(fields[k]) for k in range(2)]
                cells[key] = [dense[k].of(fields[k]) for k in range(2)]
    table: dict[str, list[float]] = {}
    for pair in pairs:
        query, database = (pair.place_set, pair.query), (pair.place_set, pair.database)
        truth = ground_truth(data_folder, pair)
        for name, scores in _scores(vectors[query], vectors[database], cells[query], cells[database]).items():
            table.setdefault(name, []).append(recall_at_one(scores, truth))
    return table


def _scores(
    queries: list[Floats], views: list[Floats], query_cells: list[Floats], view_cells: list[Floats]
) -> dict[str, Floats]:
    """Score every view (columns) for every query (rows), by each way of ranking."""
    similarity = [queries[k] @ views[k].T for k in range(2)]
    order = [np.argsort(-similarity[k], axis=1, kind="stable") for k in range(2)]
    scores = {f"{CHANNELS[k]}: histogram": similarity[k] for k in range(2)}
    for k in range(2):
        ranked = np.full_like(similarity[k], -9)
        for row, nearest in enumerate(order[k][:, :20]):
            fit = best_shift(query_cells[k][row], view_cells[k][nearest])
            ranked[row, nearest] = DENSE_SHARES[k] * fit + (1 - DENSE_SHARES[k]) * similarity[k][row, nearest]
        scores[f"{CHANNELS[k]}: 20 re-ranked by cells"] = ranked
    unions = {each: np.full_like(similarity[0], -9) for each in (10, 20)}
    for row in range(len(similarity[0])):
        nearest = np.unique([order[k][row, :20] for k in range(2)])
        fits = [best_shift(query_cells[k][row], view_cells[k][nearest]) for k in range(2)]
        together = sum(0.4 * fits[k] + 0.1 * similarity[k][row, nearest] for k in range(2))
        unions[20][row, nearest] = together
        first = np.isin(nearest, [order[k][row, :10] for k in range(2)])
        unions[10][row, nearest[first]] = together[first]
    scores |= {f"both: {each} + {each} re-ranked by cells": union for each, union in unions.items()}
    return scores


def general_images(data_folder: Path, count: int = 600) -> list[Path]:
    """Draw pictures of streets and rooms to make vocabularies and components from."""
    images = [
        path
        for name in ("camvid", "labelmefacade", "nyuv2")
        for path in data.training_images(data_folder / "segmentation", name)
    ]
    chosen = np.random.default_rng(0).permutation(len(images))[:count]
    return [images[index] for index in sorted(chosen)]


def place_images(data_folder: Path, place_set: str, folder: str) -> list[Path]:
    """List a folder's pictures by name."""
    return sorted(p for p in (data_folder / "places" / place_set / folder).iterdir() if p.suffix in (".jpg", ".png"))


def ground_truth(data_folder: Path, pair: Pair) -> npt.NDArray[np.bool_]:
    """Read which views (columns) answer which queries (rows)."""
    rows = {path.name: i for i, path in enumerate(place_images(data_folder, pair.place_set, pair.query))}
    columns = {path.name: i for i, path in enumerate(place_images(data_folder, pair.place_set, pair.database))}
    truth = np.zeros((len(rows), len(columns)), np.bool_)
    with (data_folder / "places" / pair.place_set / "ground_truth.csv").open() as lines:
        for line in csv.DictReader(lines):
            if (line["query_folder"], line["database_folder"]) == (pair.query, pair.database):
                truth[rows[line["query_file"]], columns[line["database_file"]]] = True
    return truth


def _embedded(embed: Embed, paths: Iterable[Path]) -> list[list[Field]]:
    fields: list[list[Field]] = [[], []]
    for path in paths:
        image = read_rgb(path)
        for known, field in zip(fields, embed(image), strict=True):
            known.append(field)
    return fields


def _field(maps: torch.Tensor) -> Field:
    rows, columns = maps.shape[2:]
    return Field(maps[0].flatten(1).T.half().numpy(), (rows, columns))


def show(table: dict[str, list[float]], pairs: Sequence[Pair] = PAIRS) -> str:
    """Lay the table out for reading."""
    lines = [f"{'':32s}" + "".join(f"{pair.name:>7s}" for pair in pairs)]
    lines += [f"{name:32s}" + "".join(f"{value:7.1f}" for value in row) for name, row in table.items()]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.evaluate_places", description="Recall at 1 on places."
    )
    parser.add_argument("--network", type=Path, required=True, help="checkpoint.pt or an exported .safetensors")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--pairs", nargs="+", default=[pair.name for pair in PAIRS], help="only these")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the table here")
    options = parser.parse_args(arguments)
    keep_freed_memory()
    torch.set_num_threads(options.threads)
    faiss.omp_set_num_threads(options.threads)
    cv2.setNumThreads(1)
    began = time.monotonic()
    pairs = [pair for pair in PAIRS if pair.name in options.pairs]
    table = evaluate(embedder(network_of(options.network)), options.data, pairs)
    print(show(table, pairs))
    print(f"{time.monotonic() - began:.0f} s")
    if options.json:
        options.json.write_text(json.dumps({"pairs": [pair.name for pair in pairs], "recall": table}, indent=1))


if __name__ == "__main__":
    main()
