"""Write a drawn building as a folder of images with ground truth: ``python -m scenes DIR [--kind lobby]``.

DIR/database, DIR/query, DIR/unknown (the floor that is not in the database) and DIR/ground_truth.csv, as
``./revisit evaluate pairs`` reads them.
"""

import argparse
import csv
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2

from scenes.building import KINDS, Building, Shot, building

COLUMNS = ("query_folder", "query_file", "database_folder", "database_file")
"""Columns of the table of right answers (`lab.datasets.pairs`)."""

QUALITY = 92


def write(one: Building, folder: Path, count: int = 1) -> None:
    """Write a building as a set of images with ground truth.

    Parameters
    ----------
    one : Building
    folder : Path
        Gets ``database``, ``query`` and ``unknown``, folders of JPEG images, and ``ground_truth.csv``, which names
        the image of the same floor and spot for each image of ``query``.
    count : int
        Query images of each spot.
    """
    enrolled = _saved(one.enrolments(), folder / "database")
    queries = _saved(one.queries(count), folder / "query")
    _saved(one.unknown(count), folder / "unknown")
    right = dict(enrolled)
    with (folder / "ground_truth.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        table.writerows(("query", name, "database", right[place]) for place, name in queries)


def _saved(shots: Iterable[Shot], folder: Path) -> list[tuple[tuple[int, int], str]]:
    """Save images; returns ((floor, spot), file name) of each."""
    folder.mkdir(parents=True, exist_ok=True)
    saved: list[tuple[tuple[int, int], str]] = []
    for floor, spot, image in shots:
        number = 1 + sum(place == (floor, spot) for place, _ in saved)
        name = f"floor{floor}-spot{spot:02d}-{number}.jpg"
        if not cv2.imwrite(str(folder / name), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY]):
            raise OSError(f"{folder / name} could not be written")
        saved.append(((floor, spot), name))
    return saved


def main(arguments: Sequence[str] | None = None) -> int:
    """Command-line entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m scenes",
        description="Draw look-alike floors of a building: DIR/database, DIR/query, DIR/unknown, DIR/ground_truth.csv.",
    )
    parser.add_argument("folder", metavar="DIR", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=sorted(KINDS), default="corridor")
    parser.add_argument("--floors", type=int, default=4, help="floors that are enrolled; one more is not")
    parser.add_argument("--spots", type=int, default=6, help="spots on each floor, a step apart")
    parser.add_argument("--queries", type=int, default=1, help="query images of each spot")
    options = parser.parse_args(arguments)
    write(building(options.seed, options.floors, options.spots, options.kind), options.folder, options.queries)
    return 0


if __name__ == "__main__":
    sys.exit(main())
