"""The usual names of images with positions: ``@easting@northing@...@.jpg``, in folders ``database`` and ``queries``.

Benchmarks of the field read such folders (VPR-methods-evaluation, the deep visual geo-localization benchmark), and
VPR-datasets-downloader writes them. Only the first two fields, metres, are read here.
"""

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lab.datasets.dataset import RADIUS_M, Dataset, UnexpectedLayout, images_in, within
from schemas.description import Doubles
from schemas.errors import InvalidParameters

EXPECTED = """\
  ROOT/database/@0584353.20@4477041.69@...@.jpg
  ROOT/queries/...                     (easting and northing in the name, metres)"""

FIELDS = 14
"""Fields of a name: easting, northing, zone and its letter, latitude, longitude, pano, tile, heading, pitch, roll,
height, time, note."""


def read(root: Path, *, radius_m: float = RADIUS_M) -> list[Dataset]:
    """One set whose right answers were taken within a radius.

    Raises
    ------
    UnexpectedLayout
        When a folder is missing or empty, or a name has no position.
    """
    database, positions = images_with_positions(root / "database", EXPECTED)
    queries, query_positions = images_with_positions(root / "queries", EXPECTED)
    return [
        Dataset(
            name=root.name,
            database=tuple(database),
            queries=tuple(queries),
            positives=tuple(within(positions, query_positions, radius_m)),
            truth=f"within {radius_m:g} m (UTM)",
            database_positions=positions,
            query_positions=query_positions,
        )
    ]


def images_with_positions(folder: Path, expected: str) -> tuple[list[Path], Doubles]:
    """The images of a folder, and easting and northing of each, float64 (images, 2); raises UnexpectedLayout."""
    files = images_in(folder, expected)
    positions = []
    for path in files:
        found = re.match(r"@\s*(-?\d+(?:\.\d+)?)@\s*(-?\d+(?:\.\d+)?)@", path.name)
        if found is None:
            raise UnexpectedLayout(folder, f"{path.name} does not begin with @easting@northing@", expected)
        positions.append((float(found[1]), float(found[2])))
    return files, np.array(positions)


def name_of(position: Sequence[float], note: str, suffix: str) -> str:
    """A name with a position in metres and a note (the former name), the fields between them empty.

    >>> name_of((584353.2, 4477041.69), "0001", ".jpg")
    '@0584353.20@4477041.69@@@@@@@@@@@@0001@.jpg'
    """
    east, north = (f"{metres:010.2f}" for metres in position)
    # What separates fields and folders cannot stand in a note.
    return "@".join(["", east, north, *[""] * (FIELDS - 3), re.sub(r"[@/\\]", "-", note), suffix])


def export(dataset: Dataset, folder: Path) -> None:
    """Copy the images of a set into ``database`` and ``queries`` under such names, for other programs.

    Raises
    ------
    InvalidParameters
        The set has no positions, two of its images would get one name, or the folder exists already. Nothing is
        written then.
    """
    if dataset.database_positions is None or dataset.query_positions is None:
        raise InvalidParameters.of(
            "export",
            f"{dataset.name} is judged by its table and has no positions to write into names; kitti, pitts30k and "
            "folder have some",
        )
    if folder.exists():
        raise InvalidParameters.of("export", f"{folder} exists already; name a new folder")
    copies: dict[Path, Path] = {}
    for name, images, positions in (
        ("database", dataset.database, dataset.database_positions),
        ("queries", dataset.queries, dataset.query_positions),
    ):
        for image, at in zip(images, positions, strict=True):
            target = folder / name / name_of(at, image.stem, image.suffix)
            if target in copies:
                raise InvalidParameters.of("export", f"{copies[target]} and {image} have the same name and position")
            copies[target] = image
    for target, image in copies.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(image, target)
