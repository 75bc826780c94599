"""Anybody's images with a table of positions."""

import os
import unicodedata
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lab.datasets.dataset import ENDINGS, RADIUS_M, Dataset, UnexpectedLayout, composed, rows_of, within
from lab.metrics.recall import Indices
from schemas.description import Doubles
from schemas.globe import EARTH_RADIUS_M

EXPECTED = """\
  ROOT/positions.csv   one row an image, with the columns
      file             path of the image below ROOT
      x,y              metres (x_m,y_m likewise), or lat,lon in degrees
      heading          degrees clockwise from north, optional (heading_deg likewise)
      role             database or query; or the files lie in folders database/ and query/"""


def read(
    root: Path,
    *,
    table: str = "positions.csv",
    radius_m: float = RADIUS_M,
    heading_tolerance: float | None = None,
) -> list[Dataset]:
    """One set whose right answers were taken near the query and, if wanted, looking the same way.

    Parameters
    ----------
    root : Path
    table : str
    radius_m : float
    heading_tolerance : float or None
        Degrees; None ignores headings.

    Raises
    ------
    UnexpectedLayout
        When the table, a column, a role or an image is missing, an image has several rows, or a number cannot be read.
    """
    path = root / table
    rows = rows_of(path, ["file"], EXPECTED)
    twice = [name for name, rows_of_it in Counter(composed(row["file"]) for row in rows).items() if rows_of_it > 1]
    if twice:
        raise UnexpectedLayout(path, f"{len(twice)} images have several rows: {', '.join(twice[:5])}", EXPECTED)
    roles = [row.get("role") or Path(row["file"]).parts[0] for row in rows]
    odd = sorted(set(roles) - {"database", "query"})
    if odd:
        raise UnexpectedLayout(path, f"an image is neither database nor query but {odd[0]!r}", EXPECTED)
    if {"database", "query"} - set(roles):
        raise UnexpectedLayout(path, f"all images are {roles[0]}; both roles are needed", EXPECTED)
    files = [_found(root, row["file"]) for row in rows]
    missing = [row["file"] for row, file in zip(rows, files, strict=True) if not file.is_file()]
    if missing:
        raise UnexpectedLayout(path, f"{len(missing)} images are not there: {', '.join(missing[:5])}", EXPECTED)
    positions, points = _metres(rows, path)
    is_query = np.array([role == "query" for role in roles])
    positives = within(points[~is_query], points[is_query], radius_m)
    truth = f"within {radius_m:g} m"
    if heading_tolerance is not None:
        headings = _column(rows, ("heading", "heading_deg"), path)
        positives = _facing(positives, headings[~is_query], headings[is_query], heading_tolerance)
        truth += f" and {heading_tolerance:g} degrees of heading"
    if unnamed := _unnamed(root, files):
        truth += f"; images that {table} does not name take no part: {unnamed}"
    return [
        Dataset(
            name=root.name,
            database=tuple(f for f, q in zip(files, is_query, strict=True) if not q),
            queries=tuple(f for f, q in zip(files, is_query, strict=True) if q),
            positives=tuple(positives),
            truth=truth,
            database_positions=positions[~is_query],
            query_positions=positions[is_query],
        )
    ]


def _found(root: Path, name: str) -> Path:
    """The file of this name, however its accents are written."""
    forms = (root / name, root / composed(name), root / unicodedata.normalize("NFD", name))
    return next((file for file in forms if file.is_file()), forms[0])


def _unnamed(root: Path, named: Sequence[Path]) -> int:
    """How many images lie below a folder besides those that its table names; none of hidden folders."""
    known, count = set(named), 0
    for folder, folders, files in os.walk(root):
        # Hidden folders hold no images of a set: thumbnails, or what the links of git-annex lead to.
        folders[:] = [name for name in folders if not name.startswith(".")]
        shown = (Path(folder, name) for name in files if not name.startswith("."))
        count += sum(path.suffix.lower() in ENDINGS and path not in known for path in shown)
    return count


def _facing(positives: Sequence[Indices], database: Doubles, queries: Doubles, tolerance: float) -> list[Indices]:
    """Those positives whose heading differs by at most the tolerance, around the circle."""
    kept = []
    for near, heading in zip(positives, queries, strict=True):
        apart = np.abs((database[near] - heading + 180) % 360 - 180)
        kept.append(near[apart <= tolerance])
    return kept


def _metres(rows: list[dict[str, str]], path: Path) -> tuple[Doubles, Doubles]:
    """Positions in a plane, float64 (rows, 2): x and y as given, or east and north of the mean position; and points
    whose distances are those on the ground, the same or on the globe, float64 (rows, 3)."""
    if "lat" not in rows[0]:
        plane = np.column_stack([_column(rows, ("x", "x_m"), path), _column(rows, ("y", "y_m"), path)])
        return plane, plane
    degrees = [_column(rows, (name,), path) for name in ("lat", "lon")]
    for values, name, most in zip(degrees, ("lat", "lon"), (90, 180), strict=True):
        if np.abs(values).max() > most:
            line = int(np.argmax(np.abs(values) > most)) + 2
            raise UnexpectedLayout(path, f"line {line}: {name} is not within {most} degrees of 0", EXPECTED)
    lat, lon = map(np.radians, degrees)
    # A plane through the mean position: hardly off within a city, a tenth where a set has cities far north and south.
    # So what is near is told on the globe. Longitudes are taken relative to the first one, so that a set on either
    # side of 180 degrees stays together.
    east = (lon - lon[0] + np.pi) % (2 * np.pi) - np.pi
    plane = EARTH_RADIUS_M * np.column_stack([(east - east.mean()) * np.cos(lat.mean()), lat - lat.mean()])
    globe = EARTH_RADIUS_M * np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return plane, globe


def _column(rows: list[dict[str, str]], names: tuple[str, ...], path: Path) -> Doubles:
    """One column of finite numbers, under the first of these names that is there."""
    name = next((n for n in names if n in rows[0]), None)
    if name is None:
        there = ", ".join(repr(column) for column in rows[0])
        raise UnexpectedLayout(path, f"there is no column {names[0]}; there are {there}", EXPECTED)
    for line, row in enumerate(rows, start=2):
        try:
            fine = np.isfinite(float(row[name]))
        except (TypeError, ValueError):
            fine = False
        if not fine:
            raise UnexpectedLayout(path, f"line {line}: {name} is {row[name]!r}, not a number", EXPECTED)
    return np.array([float(row[name]) for row in rows])
