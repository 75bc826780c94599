"""How the database of a set lies in the world, and what a user would say of its images: names of places or positions.

Most sets come with right answers alone. Maps are enrolled with names or positions, though, and a decision may use
them, so that a set must be given them to be decided about as a user's map would be.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from lab.datasets.dataset import Dataset
from lab.metrics.recall import Indices

TOLERANCE_M = 5.0
"""Metres that the tolerance of a walk's ground truth is taken to be."""

APART_M = 1000.0
"""Metres between the parts of a set: floors, or recordings of other corridors."""

MOSTLY = 0.75
"""Share of queries whose right answers must follow each other in a walk; a robot may pass a place twice."""


@dataclass(frozen=True, eq=False)
class Layout:
    """How the images of a database follow each other.

    Parameters
    ----------
    walk : bool
        Whether images follow each other along a way. Otherwise they show places that have nothing to do with each
        other, or nothing is known.
    unit : int64 of shape (database images,)
        Number of the place: of a walk each image is one.
    part : int64 of shape (database images,)
        Number of the series of files: a floor, a corridor; all 0 where the set is no walk.
    tolerance : int
        Units by which a right answer may lie from the middle of the right answers; 0 where the set is no walk.
    named : bool
        Whether `unit` comes from the ground truth: each query's right answers are all images of one place.
    """

    walk: bool
    unit: Indices
    part: Indices
    tolerance: int
    named: bool

    def near(self, images: Indices, units: int) -> Indices:
        """Database images within so many units of any of `images`, in the same part; ascending."""
        apart = np.abs(self.unit[:, None] - self.unit[images])
        adjacent = (apart <= units) & (self.part[:, None] == self.part[images])
        return np.flatnonzero(adjacent.any(axis=1))


def layout(dataset: Dataset) -> Layout:
    """Read the layout of a set from its right answers and the names of its files.

    Notes
    -----
    Right answers of different queries either are the same images or share none: the set shows separate places, ten
    places over a year for instance. But where right answers are several images out of a longer series of numbered
    files, as every fifth frame of a floor, they are neighbours on a walk that happen not to overlap.
    """
    count = len(dataset.database)
    right = sorted({tuple(p.tolist()) for p in dataset.positives if len(p)})
    series = [re.sub(r"\d+$", "", path.stem) for path in dataset.database]
    _, part = np.unique(series, return_inverse=True)
    disjoint = sum(map(len, right)) == len({image for group in right for image in group})
    whole = all(len(group) == 1 or len(group) == int((part == part[group[0]]).sum()) for group in right)
    nothing = np.zeros(count, np.int64)
    if right and disjoint and whole:
        # A database image that no query shows is a place of its own.
        unit = np.full(count, -1, np.int64)
        for number, group in enumerate(right):
            unit[list(group)] = number
        unit[unit < 0] = np.arange(len(right), len(right) + int((unit < 0).sum()))
        return Layout(False, _in_order_of_files(unit), nothing, 0, True)
    follow = [p[-1] - p[0] + 1 == len(p) for p in dataset.positives if len(p)]
    walk = bool(right) and float(np.mean(follow)) >= MOSTLY
    each = np.arange(count, dtype=np.int64)
    if not walk:
        return Layout(False, each, nothing, 0, False)
    middle = int(np.median([len(p) for p in dataset.positives if len(p)])) // 2
    return Layout(True, each, part.astype(np.int64), max(middle, 1), False)


def _in_order_of_files(unit: Indices) -> Indices:
    """The same grouping, numbered by the first image of each place."""
    _, first, group = np.unique(unit, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first)).astype(np.int64)[group]


def with_attributes(dataset: Dataset) -> Dataset:
    """A set whose database images have what a user would say of them.

    Names of places where the set shows separate places. Positions along a walk: images follow each other in a line at
    such a distance that the tolerance of the ground truth is 5 m, and parts of the walk lie 1 km apart. What the set
    says of itself stays, and a set of which nothing is known gets nothing.
    """
    if dataset.places is not None or dataset.database_positions is not None:
        return dataset
    found = layout(dataset)
    if found.named:
        return replace(dataset, places=tuple(f"place {unit + 1}" for unit in found.unit))
    if not found.walk:
        return dataset
    step = TOLERANCE_M / found.tolerance
    positions = np.column_stack([found.unit * step, found.part * APART_M])
    return replace(dataset, database_positions=positions.astype(np.float64))
