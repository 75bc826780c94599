"""What is lost where the queries come from another camera: ``python -m lab.benchmarks.lenses --root DIR``.

Of all queries the middle is left, as a camera with a narrower field of view takes them, or of all enrolled images, so
that the queries are those of a wider one; or of both, so that queries may be turned without an edge being seen. Each is
measured as `lab.decide` does: everything enrolled, and half of the places.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from lab.benchmarks.carried import HEADS, measure, redrawn
from lab.datasets import pairs
from lab.datasets.dataset import Dataset
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from scenes.geometry import Pixels
from schemas.image import Image
from schemas.settings import read_settings
from worker.images.framing import framed
from worker.service.query_options import QueryOptions

Camera = Literal["the map's", "narrower", "wider", "turned"]


def middle(pixels: Pixels, zoom: float) -> Pixels:
    """What a camera takes that shows things `zoom` times as large, more than 1."""
    return np.asarray(framed(Image.of(pixels), 1 / zoom).pixels)


def turned(pixels: Pixels, zoom: float, degrees: float) -> Pixels:
    """What `middle` leaves of an image that was turned around its centre."""
    height, width = pixels.shape[:2]
    turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), degrees, 1.0)
    return middle(np.asarray(cv2.warpAffine(pixels, turn, (width, height), borderMode=cv2.BORDER_REFLECT)), zoom)


def taken(dataset: Dataset, folder: Path, camera: Camera, zoom: float, degrees: float = 0.0) -> Dataset:
    """The set with queries by another camera than the map's."""
    draw = partial(middle, zoom=zoom)
    match camera:
        case "turned":
            queries = redrawn(dataset.queries, partial(turned, zoom=zoom, degrees=degrees), folder / "turned")
            return replace(dataset, database=redrawn(dataset.database, draw, folder), queries=queries)
        case "the map's":
            return dataset
        case "narrower":
            return replace(dataset, queries=redrawn(dataset.queries, draw, folder))
        case "wider":
            return replace(dataset, database=redrawn(dataset.database, draw, folder))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m lab.benchmarks.lenses", description=__doc__.splitlines()[0])
    parser.add_argument("--root", type=Path, required=True, help="folder of sets with tables of right answers")
    parser.add_argument("--sets", default="", help="only sets whose names begin so, comma-separated")
    parser.add_argument("--camera", default="narrower", choices=get_args(Camera), help="of the queries")
    parser.add_argument(
        "--zoom", type=float, default=1.4, help="how many times as large the narrower camera shows things"
    )
    parser.add_argument("--turned", type=float, default=0.0, metavar="DEGREES", help="by which the camera `turned` is")
    parser.add_argument("--told", type=float, nargs="+", default=[1.0], help="zooms that queries say, one by one")
    parser.add_argument("--roll", type=float, default=0.0, help="by how many degrees queries say that it was turned")
    parser.add_argument("--every", type=int, default=4, help="take every so manieth query")
    options = parser.parse_args(argv)
    sets = [one for one in pairs.read(options.root) if one.name.startswith(tuple(options.sets.split(",")))]
    shown = partial(taken, camera=options.camera, zoom=options.zoom, degrees=options.turned)
    print(f"| camera | zoom | told | {' | '.join(HEADS)} |\n| --- | --- | --- |{' --- |' * len(HEADS)}")
    with runtime_for_measuring(read_settings(), "cpu", make_scheduler=DescribeOnce) as runtime:
        for told in options.told:
            row = measure(sets, shown, runtime, options.every, QueryOptions(zoom=told, roll=options.roll))
            print(f"| {options.camera} | {options.zoom:g} | {told:g} | {row} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
