"""What changed at a place between two photos of it: things that are gone, new or moved.

Both photos are grids of cells, and an affine transform says where each cell of one lies in the other. It is exact for
one depth alone, so a cell is looked for around there; a cell that nothing around there looks like is *lost*. Lost cells
of the earlier photo that lie together are a thing that is gone, those of the later one a thing that is new: where floor
was covered there is floor beside it, so that covered floor is not lost. One of each that look alike are one thing
that moved.

Light and season alter all cells: similarity is measured between two levels that the pair itself has, that of cells at
corresponding positions and that of any.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Floats
from worker.method.context_graph import Components
from worker.method.labels import label_map

Kind = Literal["gone", "new", "moved"]
Doubles = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Point = tuple[float, float]

REACH = 0.05
"""How far around its expected position a cell is looked for, as a fraction of the longer side: room for parallax."""

LOST = 0.65
"""A cell is lost below this similarity, where 1 is usual at corresponding positions and 0 at any."""

SMALLEST = 0.004
"""Regions of a smaller share of the photo are left out: they are as often noise as things."""

RING = (2, 4)
"""The surroundings of a region: cells from so many to so many rows or columns away."""

STEADY = 3
"""A cell of a region is compared with so many cells of its surroundings, those most like it."""

SURE = 0.4
"""Confidence from which a change is told."""

LARGEST_SHORTAGE = 0.5
"""A cell's shortage of its label is counted up to this."""

WEIGHTS = {"size": 0.83, "contrast": 17.88, "shortage": 2.77, "border": -5.45}
"""Weights of a region's features in the log-odds that it is a thing that changed: a logistic regression on drawn places
that were refurnished and on photos of places where nothing was (docs/changes.md)."""

BIAS = -6.8

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
class PhotoCells:
    """A photo as cells.

    Parameters
    ----------
    cells : float32 of shape (rows, columns, channels)
        Embeddings, unit length.
    scores : float32 of shape (rows, columns, labels)
        Cosines of the cells with the labels.
    static : bool of shape (rows, columns)
        False for cells of things that move by themselves: they are not compared.
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.
    """

    cells: Floats
    scores: Floats
    static: Booleans
    extent: Point

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.static.shape
        return rows, columns


@dataclass(frozen=True, eq=False)
class Spot:
    """A region of one photo.

    Parameters
    ----------
    centre, extent : (float, float)
        (x, y) of its bounding box's centre, and (width, height) of the box, in fractions of the longer side.
    share : float
        Share of the photo's cells.
    cells : bool of shape (rows, columns)
    """

    centre: Point
    extent: Point
    share: float
    cells: Booleans


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
class Region:
    """Lost cells of one photo that lie together.

    Parameters
    ----------
    spot : Spot
    label, instead : int
        Of the region, and of what the other photo shows there: the largest mean score.
    features : mapping of name to float
        ``size``: log of the share; ``contrast``: how unlike its surroundings it is, 1 less the cosine; ``shortage``:
        by how much its cells' labels fall behind the best ones around there; ``border``: share of its border beyond
        which nothing is compared.
    look : float32 of shape (n, channels)
        Its cells, unit length.
    around : float32 of shape (m, channels)
        Cells of its surroundings.
    """

    spot: Spot
    label: int
    instead: int
    features: dict[str, float] = field(repr=False)
    look: Floats = field(repr=False)
    around: Floats = field(repr=False)

    @property
    def confidence(self) -> float:
        """Probability that it is a thing that changed, 0..1."""
        odds = BIAS + sum(weight * self.features[name] for name, weight in WEIGHTS.items())
        return float(1 / (1 + np.exp(-odds)))


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


@dataclass(frozen=True, eq=False)
class _Compared:
    """One photo against another; arrays are (rows, columns), `at` rows and columns of the expected positions."""

    comparable: Booleans
    similarity: Doubles
    shortage: Doubles
    at: tuple[Indices, Indices]
    usual: float


def find(then: PhotoCells, now: PhotoCells, transform: Doubles, components: Components, sure: float = SURE) -> Changes:
    """What is gone, new or moved.

    Parameters
    ----------
    then, now : PhotoCells
        By one encoder and one list of labels.
    transform : float of shape (2, 3)
        Affine, invertible: positions (x, y, 1) in `then` to those in `now`, fractions of the longer side.
    components : Components
    sure : float
        Changes of a smaller confidence are left out, 0..1.

    Raises
    ------
    numpy.linalg.LinAlgError
        The transform cannot be inverted.
    """
    lost = find_lost(then, now, transform, components)
    gone, new = list(lost.gone), list(lost.new)
    changes = []
    for one, other in moved(lost, transform, sure):
        gone.remove(one)
        new.remove(other)
        surer = max(one, other, key=lambda end: end.confidence)
        changes.append(Change("moved", surer.label, None, surer.confidence, one.spot, other.spot))
    changes += [
        Change("gone", one.label, one.instead, one.confidence, one.spot, None) for one in gone if one.confidence >= sure
    ]
    changes += [
        Change("new", one.label, one.instead, one.confidence, None, one.spot) for one in new if one.confidence >= sure
    ]
    changes.sort(key=lambda one: -one.confidence)
    return Changes(tuple(changes), lost.compared, lost.usual)


def find_lost(then: PhotoCells, now: PhotoCells, transform: Doubles, components: Components) -> Lost:
    """Regions of each photo that the other lacks, whatever their confidence; raises as `find`."""
    back = np.linalg.inv(np.vstack([transform, [0.0, 0.0, 1.0]]))[:2]
    before, after = _compare(then, now, transform), _compare(now, then, back)
    gone, new = _regions(then, now, before, components), _regions(now, then, after, components)
    return Lost(gone, new, float(after.comparable.mean()), (before.usual + after.usual) / 2)


def _compare(here: PhotoCells, there: PhotoCells, transform: Doubles) -> _Compared:
    """PhotoCells for each cell of one photo in the other, around where it is expected."""
    rows, columns = there.shape
    x, y = (np.arange(n) + 0.5 for n in here.shape[::-1])
    across, down = np.meshgrid(x / here.shape[1] * here.extent[0], y / here.shape[0] * here.extent[1])
    expected = np.stack([across, down], axis=-1) @ transform[:, :2].T + transform[:, 2]
    row = np.rint(expected[..., 1] / there.extent[1] * rows - 0.5).astype(np.intp)
    column = np.rint(expected[..., 0] / there.extent[0] * columns - 0.5).astype(np.intp)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    at = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    comparable = inside & here.static & there.static[at]
    labels, best = label_map(here.scores), there.scores.max(axis=-1)
    likest, shortage = np.full(here.shape, -1.0), np.full(here.shape, LARGEST_SHORTAGE)
    reach_down, reach_across = round(REACH / there.extent[1] * rows), round(REACH / there.extent[0] * columns)
    for dy in range(-reach_down, reach_down + 1):
        for dx in range(-reach_across, reach_across + 1):
            r, c = row + dy, column + dx
            within = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
            r, c = np.clip(r, 0, rows - 1), np.clip(c, 0, columns - 1)
            cosine = np.einsum("rcd,rcd->rc", here.cells, there.cells[r, c])
            likest = np.where(within, np.maximum(likest, cosine), likest)
            short = best[r, c] - there.scores[r, c, labels]
            shortage = np.where(within, np.minimum(shortage, short), shortage)
    usual = float(np.median(likest[comparable])) if comparable.any() else 0.0
    ours, theirs = (look.cells.reshape(-1, look.cells.shape[-1])[::7] for look in (here, there))
    chance = float(np.median(ours @ theirs.T))
    return _Compared(comparable, (likest - chance) / max(usual - chance, 1e-6), shortage, at, usual)


def _regions(here: PhotoCells, there: PhotoCells, compared: _Compared, components: Components) -> list[Region]:
    numbers = components(compared.comparable & (_smooth(compared.similarity) < LOST))
    found = []
    for number in range(1, int(numbers.max(initial=0)) + 1):
        cells = numbers == number
        if cells.mean() < SMALLEST:
            continue
        other = np.zeros(there.shape, np.bool_)
        other[compared.at[0][cells], compared.at[1][cells]] = True
        near = _grown(cells, 1)
        around = here.cells[_grown(cells, RING[1]) & ~_grown(cells, RING[0] - 1)]
        features = {
            "size": float(np.log(cells.mean())),
            "contrast": _contrast(here.cells[cells], around),
            "shortage": float(compared.shortage[cells].mean()),
            "border": float((near & ~compared.comparable).sum() / max(int((near & ~cells).sum()), 1)),
        }
        label, instead = (int(scores.mean(axis=0).argmax()) for scores in (here.scores[cells], there.scores[other]))
        found.append(Region(_spot(cells, here.extent), label, instead, features, here.cells[cells], around))
    return found


def _contrast(look: Floats, around: Floats) -> float:
    """How unlike its surroundings a region is: 1 less the mean cosine of its cells with those most like them."""
    if not len(around):
        return 0.0
    cosines = np.sort(look @ around.T, axis=1)
    return float(1 - cosines[:, -STEADY:].mean())


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


def moved(
    lost: Lost, transform: Doubles, sure: float = SURE, similarity: float = SAME_THING
) -> list[tuple[Region, Region]]:
    """Pairs of a region that is gone and one that is new which are one thing, likest first, each at most once.

    `sure` is what the confidence of the surer end has to be, `similarity` how `alike` the two.
    """
    pairs = []
    for one in lost.gone:
        for other in lost.new:
            doubtful, surer = sorted((one.confidence, other.confidence))
            if doubtful >= min(HINT, sure) and surer >= sure and _may_be_one(one, other, transform):
                found = alike(one, other, lost.usual)
                if found >= similarity:
                    pairs.append((found, one, other))
    pairs.sort(key=lambda pair: -pair[0])
    chosen: list[tuple[Region, Region]] = []
    for _, one, other in pairs:
        if all(one is not taken and other is not given for taken, given in chosen):
            chosen.append((one, other))
    return chosen


def _grown(cells: Booleans, by: int) -> Booleans:
    """The cells and all that are at most `by` rows and columns away."""
    rows, columns = cells.shape
    padded = np.pad(cells, by)
    grown = np.zeros_like(cells)
    for y in range(2 * by + 1):
        for x in range(2 * by + 1):
            grown |= padded[y : y + rows, x : x + columns]
    return grown


def _smooth(values: Doubles) -> Doubles:
    """Means over 3 x 3 cells; the border counts as it continues."""
    rows, columns = values.shape
    padded = np.pad(values, 1, mode="edge")
    total: Doubles = np.sum([padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3)], axis=0)
    return total / 9


def _spot(cells: Booleans, extent: Point) -> Spot:
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    height, width = extent[1] / cells.shape[0], extent[0] / cells.shape[1]
    left, right = float(columns[0]) * width, float(columns[-1] + 1) * width
    top, bottom = float(rows[0]) * height, float(rows[-1] + 1) * height
    return Spot(((left + right) / 2, (top + bottom) / 2), (right - left, bottom - top), float(cells.mean()), cells)
