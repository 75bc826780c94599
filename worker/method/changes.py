"""What changed at a place between two photos of it: things that are gone, new or moved.

Regions of the earlier photo that the later one lacks (`lost_regions`) are things that are gone, those of the later one
things that are new. One of each that look alike are one thing that moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from schemas.description import Doubles
from worker.method.context_graph import Components
from worker.method.lost_cells import REACH, PhotoCells, compare
from worker.method.lost_regions import Region, Spot, find_regions

Kind = Literal["gone", "new", "moved"]

SURE = 0.4
"""Confidence from which a change is told."""

HINT = 0.1
"""Confidence of a region from which it may be the other end of a thing that moved, where one end is sure."""

ALIKE = 0.66
"""Cosine of the cells of two regions, as a share of that at corresponding positions, below which they are not alike."""

SAME_THING = 0.2
"""By how much more a region that is gone and one that is new have to be alike than each is like what is beside the
other, to be one thing that moved. Their labels do not count: of a small thing they are guesses."""

LIKE_SIZE = 2.5
"""Two regions are one thing that moved when neither is more than this many times as large as the other."""


@dataclass(frozen=True, eq=False)
class Change:
    """A thing that changed.

    Parameters
    ----------
    kind : {"gone", "new", "moved"}
    label : int
        Of the thing.
    instead : int or None
        Label of what the other photo shows in its place; None for a thing that moved.
    confidence : float
        That a thing changed there, 0..1, of a thing that moved at its surer end; the label is a guess of its own.
    then, now : Spot or None
        Where it was and where it is; of a thing that is gone, or new, the other is None.
    """

    kind: Kind
    label: int
    instead: int | None
    confidence: float
    then: Spot | None
    now: Spot | None


@dataclass(frozen=True, eq=False)
class Changes:
    """What changed between two photos.

    Parameters
    ----------
    changes : tuple of Change
        Most confident first.
    compared : float
        Share of the later photo that could be compared: within the earlier one, and static in both.
    similarity : float
        Cosine that is usual between corresponding cells: the smaller, the more light and season differ.
    """

    changes: tuple[Change, ...]
    compared: float
    similarity: float


@dataclass(frozen=True, eq=False)
class Lost:
    """What each photo lacks of the other.

    Parameters
    ----------
    gone, new : sequence of Region
        Of the earlier photo and of the later one.
    compared, usual : float
        As `compared` and `similarity` of `Changes`.
    """

    gone: Sequence[Region]
    new: Sequence[Region]
    compared: float
    usual: float


def find(then: PhotoCells, now: PhotoCells, transform: Doubles, components: Components) -> Changes:
    """What is gone, new or moved.

    Parameters
    ----------
    then, now : PhotoCells
        By one encoder and one list of labels.
    transform : float64 of shape (2, 3)
        Affine, invertible: positions (x, y, 1) in `then` to those in `now`, fractions of the longer side.
    components : Components

    Raises
    ------
    numpy.linalg.LinAlgError
        The transform cannot be inverted.
    """
    lost = find_lost(then, now, transform, components)
    gone, new = list(lost.gone), list(lost.new)
    changes = []
    for one, other in moved(lost, transform):
        gone.remove(one)
        new.remove(other)
        surer = max(one, other, key=lambda end: end.confidence)
        changes.append(Change("moved", surer.label, None, surer.confidence, one.spot, other.spot))
    changes += [
        Change("gone", one.label, one.instead, one.confidence, one.spot, None) for one in gone if one.confidence >= SURE
    ]
    changes += [
        Change("new", one.label, one.instead, one.confidence, None, one.spot) for one in new if one.confidence >= SURE
    ]
    changes.sort(key=lambda one: -one.confidence)
    return Changes(tuple(changes), lost.compared, lost.usual)


def find_lost(then: PhotoCells, now: PhotoCells, transform: Doubles, components: Components) -> Lost:
    """Regions of each photo that the other lacks, whatever their confidence; raises as `find`."""
    back = np.linalg.inv(np.vstack([transform, [0.0, 0.0, 1.0]]))[:2]
    before, after = compare(then, now, transform), compare(now, then, back)
    gone, new = find_regions(then, now, before, components), find_regions(now, then, after, components)
    return Lost(gone, new, float(after.comparable.mean()), (before.usual + after.usual) / 2)


def alike(one: Region, other: Region, usual: float) -> float:
    """By how much more the cells of two regions are alike than those of each are like what is beside the other.

    Means of the best cosine of each cell, -1..1 each, so that the light and what both stand on do not count; 0 for
    regions that are not `ALIKE`.
    """
    cosines = one.look @ other.look.T
    each_other = (cosines.max(axis=1).mean() + cosines.max(axis=0).mean()) / 2
    if each_other < ALIKE * usual:
        return 0.0
    return float(each_other - (_like_around(one, other) + _like_around(other, one)) / 2)


def _like_around(one: Region, other: Region) -> float:
    """How like what is beside another region the cells of one are."""
    return float((one.look @ other.around.T).max(axis=1).mean()) if len(other.around) else 0.0


def _may_be_one(one: Region, other: Region, transform: Doubles) -> bool:
    """Whether a region of the earlier photo and one of the later are of like size, and apart."""
    growth = abs(float(np.linalg.det(transform[:, :2])))
    expected = transform[:, :2] @ np.array(one.spot.centre) + transform[:, 2]
    ratio = other.spot.share / (one.spot.share * max(growth, 1e-9))
    apart = float(np.linalg.norm(expected - other.spot.centre))
    return 1 / LIKE_SIZE <= ratio <= LIKE_SIZE and apart > REACH


def moved(lost: Lost, transform: Doubles, similarity: float = SAME_THING) -> list[tuple[Region, Region]]:
    """Pairs of a region that is gone and one that is new which are one thing, likest first, each at most once.

    `similarity` is how `alike` the two have to be.
    """
    pairs = []
    for one in lost.gone:
        for other in lost.new:
            doubtful, surer = sorted((one.confidence, other.confidence))
            if doubtful >= HINT and surer >= SURE and _may_be_one(one, other, transform):
                found = alike(one, other, lost.usual)
                if found >= similarity:
                    pairs.append((found, one, other))
    pairs.sort(key=lambda pair: -pair[0])
    chosen: list[tuple[Region, Region]] = []
    for _, one, other in pairs:
        if all(one is not taken and other is not given for taken, given in chosen):
            chosen.append((one, other))
    return chosen
