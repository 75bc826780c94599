"""A set of images with ground truth, and what all modules that read one share."""

import csv
import hashlib
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from lab.metrics.recall import Indices, Truth
from schemas.description import Doubles
from schemas.errors import RevisitError

ENDINGS = frozenset({".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff"})
"""Names of files that count as images."""

RADIUS_M = 25.0
"""How near a database image must have been taken to be right, unless said otherwise (paper)."""


class UnexpectedLayout(RevisitError):
    """A folder does not hold what is looked for; the text shows what was expected and what was found."""

    code = "unexpected-layout"

    def __init__(self, root: Path, problem: str, expected: str) -> None:
        super().__init__(f"{root}: {problem}\nExpected:\n{expected.rstrip()}")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Images to enrol, images to query with, and which answers are right.

    Parameters
    ----------
    name : str
        ``gardenspoint day_left -> day_right``; names the set in every table.
    database, queries : tuple of Path
        In the order that the ground truth counts them.
    positives : tuple of int64 of shape (right answers of the query,)
        Indices into `database`; empty where the database does not show the place.
    truth : str
        In words, what makes an answer right; printed with every result.
    database_positions, query_positions : float64 of shape (images, 2) or None
        Metres in the ground plane.
    allowed : int64 of shape (queries,) or None
        Online loop closure: how many of the first database images each query may be answered with. None: all.
    places : tuple of str or None
        Name of the place that each database image shows, as a user would give it.
    ignored : tuple of int64 of shape (images,), or None
        For each query the database images that are neither right nor wrong: they are left out of its answers.
    """

    name: str
    database: tuple[Path, ...]
    queries: tuple[Path, ...]
    positives: tuple[Indices, ...]
    truth: str
    database_positions: Doubles | None = None
    query_positions: Doubles | None = None
    allowed: Indices | None = None
    places: tuple[str, ...] | None = None
    ignored: tuple[Indices, ...] | None = None

    def __post_init__(self) -> None:
        for images, positions in (
            (self.database, self.database_positions),
            (self.queries, self.query_positions),
        ):
            if positions is not None and positions.shape != (len(images), 2):
                raise ValueError(f"{self.name}: {positions.shape} positions for {len(images)} images")
        if self.ignored is not None:
            both = zip(self.positives, self.ignored, strict=True)
            if any(len(np.intersect1d(right, neither)) for right, neither in both):
                raise ValueError(f"{self.name}: an image is right for a query and ignored for it too")
        if self.places is not None and len(self.places) != len(self.database):
            raise ValueError(f"{self.name}: {len(self.places)} names of places for {len(self.database)} images")
        self.judged()

    def judged(self) -> Truth:
        """The ground truth in the form that `lab.metrics.recall` counts with."""
        truth = Truth.of(self.positives, len(self.database) if self.allowed is None else self.allowed)
        if self.ignored is None:
            return truth
        return replace(truth, ignored=np.array([len(images) for images in self.ignored], np.int64))

    @property
    def sequential(self) -> bool:
        """Whether neighbouring queries mostly share right answers: a walk, whose queries are not independent.

        Where only the one frame is right, the ignored ones around it tell of the walk.
        """
        near = self.positives
        if self.ignored is not None:
            near = tuple(np.union1d(*both) for both in zip(self.positives, self.ignored, strict=True))
        shared = [len(np.intersect1d(a, b)) > 0 for a, b in pairwise(near) if len(a) and len(b)]
        return bool(shared) and float(np.mean(shared)) > 0.5


def natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sort key by which img2 comes before img10; sorting by bare text offsets images from their truth."""
    parts = re.split(r"(\d+)", path.name.lower())
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts], path.name


def composed(name: str) -> str:
    """A name with its accents as tables have them; macOS writes those of files as letters of their own."""
    return unicodedata.normalize("NFC", name)


def images_in(folder: Path, expected: str) -> list[Path]:
    """The images directly in a folder, in natural order of their names; hidden files are none.

    Raises
    ------
    UnexpectedLayout
        When it is no folder, has no image, or has something with such a name that is no file.
    """
    if not folder.is_dir():
        raise UnexpectedLayout(folder, "there is no such folder", expected)
    shown = [p for p in folder.iterdir() if not p.name.startswith(".")]
    found = sorted((p for p in shown if p.suffix.lower() in ENDINGS), key=natural)
    if not found:
        kinds = sorted({p.suffix.lower() or "(no ending)" for p in shown})
        raise UnexpectedLayout(folder, f"no images here; the files end in {', '.join(kinds) or 'nothing'}", expected)
    if lost := [p.name for p in found if not p.is_file()]:
        problem = f"folders, or links that lead nowhere, have names of images: {', '.join(lost[:5])}"
        raise UnexpectedLayout(folder, problem, expected)
    return found


def queries_in_database(dataset: Dataset) -> list[Path]:
    """Queries that may be answered with their own image: the same file, or the same bytes.

    In online loop closure all frames are both; there only those that may see themselves count.
    """
    if dataset.allowed is not None:
        own = {path: i for i, path in enumerate(dataset.database)}
        both = zip(dataset.queries, dataset.allowed.tolist(), strict=True)
        return [query for query, allowed in both if own.get(query, allowed) < allowed]
    by_size: dict[int, list[Path]] = {}
    for path in dataset.database:
        by_size.setdefault(path.stat().st_size, []).append(path)
    same_size = {query: by_size.get(query.stat().st_size, []) for query in dataset.queries}
    # Few files have the same size, so that few are read.
    digests = {path: digest(path) for paths in same_size.values() for path in paths}
    return [query for query, paths in same_size.items() if paths and digest(query) in {digests[p] for p in paths}]


def digest(path: Path) -> str:
    """SHA-256 of a file, in hex digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def rows_of(path: Path, columns: Sequence[str], expected: str) -> list[dict[str, str]]:
    """The rows of a CSV file that must have these columns.

    Raises
    ------
    UnexpectedLayout
        When the file or a column is missing, it cannot be read, a row has too few or too many fields, or there is
        no row.
    """
    if not path.is_file():
        raise UnexpectedLayout(path, "there is no such file", expected)
    rows = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            missing = [c for c in columns if c not in (reader.fieldnames or [])]
            if missing:
                raise UnexpectedLayout(
                    path,
                    f"column {', '.join(missing)} is missing; there are {', '.join(reader.fieldnames or [])}",
                    expected,
                )
            for row in reader:
                if empty := [c for c in columns if not row[c]]:
                    raise UnexpectedLayout(path, f"line {reader.line_num} has no {', '.join(empty)}", expected)
                if any(row.pop(None, ())):
                    problem = f"line {reader.line_num} has more fields than the heading; is a comma within one quoted?"
                    raise UnexpectedLayout(path, problem, expected)
                rows.append(row)
    except UnicodeDecodeError as error:
        problem = f"byte {error.start + 1} is no UTF-8 text; save the table as CSV in UTF-8"
        raise UnexpectedLayout(path, problem, expected) from None
    except csv.Error as error:
        raise UnexpectedLayout(path, f"line {reader.line_num + 1} cannot be read as CSV: {error}", expected) from None
    if not rows:
        raise UnexpectedLayout(path, "no rows below the heading", expected)
    return rows


def within(database: Doubles, queries: Doubles, radius_m: float) -> list[Indices]:
    """For each query the database images taken within a radius (inclusive).

    Parameters
    ----------
    database, queries : float64 of shape (images, 2) or (images, 3)
        Metres, in the ground plane or on the globe.
    radius_m : float

    Returns
    -------
    list of int64 of shape (right answers of the query,), ascending
    """
    # One query at a time: 7,608 x 10,000 distances at once would take 1.2 GB.
    return [np.flatnonzero(((database - q) ** 2).sum(axis=1) <= radius_m**2) for q in queries]
