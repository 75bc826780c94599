"""Methods of others, by what they left in a file: ranked lists, or one descriptor for each image.

Images are named by the ends of their paths, as far as needed to tell them apart: ``0001.jpg``, or ``query/0001.jpg``.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar
from zipfile import BadZipFile

import numpy as np

from lab.baselines.baseline import Tick, euclidean
from schemas.description import Floats
from schemas.errors import InvalidParameters

T = TypeVar("T")

LISTED = 5
"""Names in an error."""


@dataclass(frozen=True)
class Ranked:
    """Ranked lists: each line names a query and a database image, best first, and perhaps how far apart they are.

    Parameters
    ----------
    name : str
        As it stands in tables.
    path : Path
        Text, separated by commas or blanks; hloc's lists of pairs are such files. A third column is a distance, small
        for alike; without one the order of the lines decides. A first line ``query,database`` is skipped.
    """

    name: str
    path: Path

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database); infinite where nothing is listed.

        Raises
        ------
        InvalidParameters
            A line cannot be read, or a query of the set is not listed at all.
        """
        found = np.full((len(queries), len(database)), np.inf, np.float32)
        of_query, of_database = _finder(queries), _finder(database)
        listed = np.zeros(len(queries), np.intp)
        for number, (query, image, distance) in enumerate(self._rows):
            i, j = of_query(query), of_database(image)
            if i is not None and j is not None:
                found[i, j] = min(found[i, j], number if distance is None else distance)
                listed[i] += 1
        missing = [str(image) for image, count in zip(queries, listed, strict=True) if not count]
        _refuse_missing(self.path, "lists nothing for", missing, len(queries))
        for _ in (*database, *queries):
            tick()
        return found

    @cached_property
    def _rows(self) -> list[tuple[str, str, float | None]]:
        lines = _read(self.path, lambda path: path.read_text("utf-8-sig").splitlines())
        rows = []
        for number, line in enumerate(lines, start=1):
            fields = next(csv.reader([line], skipinitialspace=True)) if "," in line else line.split()
            if not fields or (number == 1 and fields[0].strip().lower() == "query"):
                continue
            try:
                query, image, *rest = (field.strip() for field in fields)
                distance = float(rest[0]) if rest else None
                if distance is not None and not math.isfinite(distance):
                    raise ValueError
            except ValueError:
                needed = "needs a query, a database image, and perhaps a distance, which is a finite number"
                raise InvalidParameters.of("file", f"{self.path}, line {number}: {needed}") from None
            rows.append((query, image, distance))
        return rows


@dataclass(frozen=True)
class Descriptors:
    """One descriptor for each image, compared by Euclidean distance.

    Parameters
    ----------
    name : str
        As it stands in tables.
    path : Path
        npz with ``names`` (images,) of text and ``descriptors`` (images, dimensions) of numbers.
    """

    name: str
    path: Path

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database).

        Raises
        ------
        InvalidParameters
            The file is no such file, or an image of the set has no descriptor.
        """
        return euclidean(self._of(database, tick), self._of(queries, tick))

    def _of(self, images: Sequence[Path], tick: Tick) -> Floats:
        names, descriptors = self._arrays
        place = _finder(images)
        rows = np.full(len(images), -1, np.intp)
        for row, name in enumerate(names):
            if (found := place(name)) is not None:
                rows[found] = row
                tick()
        missing = [str(image) for image, row in zip(images, rows, strict=True) if row < 0]
        _refuse_missing(self.path, "has no descriptors of", missing, len(images))
        return descriptors[rows]

    @cached_property
    def _arrays(self) -> tuple[list[str], Floats]:
        def read(path: Path) -> tuple[list[str], Floats]:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return [str(name) for name in arrays["names"]], np.asarray(arrays["descriptors"], np.float32)

        names, descriptors = _read(self.path, read)
        if descriptors.ndim != 2 or len(names) != len(descriptors) or not np.isfinite(descriptors).all():
            seen = f"{len(names)} names and descriptors of shape {descriptors.shape}"
            raise InvalidParameters.of("file", f"{self.path} has {seen}; needs finite ones, a row for each name")
        return names, descriptors


def _read(path: Path, read: Callable[[Path], T]) -> T:
    try:
        return read(path)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InvalidParameters.of("file", f"{path} cannot be read: {error}") from None


def _finder(images: Sequence[Path]) -> Callable[[str], int | None]:
    """From the end of a path to which image it names; None for an image that is none of these, or not the only one."""
    by_name: dict[str, list[int]] = {}
    for i, image in enumerate(images):
        by_name.setdefault(image.name, []).append(i)

    def find(name: str) -> int | None:
        parts = Path(name).parts
        fits = [i for i in by_name.get(parts[-1] if parts else "", ()) if images[i].parts[-len(parts) :] == parts]
        return fits[0] if len(fits) == 1 else None

    return find


def _refuse_missing(path: Path, what: str, missing: Sequence[str], count: int) -> None:
    if missing:
        listed = ", ".join(missing[:LISTED]) + (", ..." if len(missing) > LISTED else "")
        raise InvalidParameters.of("file", f"{path} {what} {len(missing)} of {count} images: {listed}")


def named(texts: Sequence[str], make: Callable[[str, Path], T]) -> list[T]:
    """Methods from texts like ``my method=file.npz``; a text without a name is named by its file.

    Where names or folders have the sign too (``runs/lr=0.1/file.npz``), the file is the longest end that there is.
    """
    return [make(*_named(text)) for text in texts]


def _named(text: str) -> tuple[str, Path]:
    parts = text.split("=")
    ends = ["=".join(parts[start:]) for start in range(len(parts))]
    path = next((end for end in ends if Path(end).is_file()), ends[min(1, len(ends) - 1)])
    name = text.removesuffix(path).removesuffix("=")
    return name or Path(path).stem, Path(path)
