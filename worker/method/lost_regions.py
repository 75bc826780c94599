"""Lost cells of a photo that lie together: regions, and how sure each is a thing that changed.

A cell is also looked for around its expected position, so that floor which something covers now is not lost: there is
floor beside it.
"""

from dataclasses import dataclass, field

import numpy as np

from schemas.description import Booleans, Floats
from worker.method.cell_regions import Point, bounding_box
from worker.method.context_graph import Components
from worker.method.lost_cells import Compared, PhotoCells

SMALLEST = 0.004
"""Regions of a smaller share of the photo are left out: they are as often noise as things."""

RING = (2, 4)
"""The surroundings of a region: cells from so many to so many rows or columns away."""

STEADY = 3
"""A cell of a region is compared with so many cells of its surroundings, those most like it."""

WEIGHTS = {"size": 0.83, "contrast": 17.88, "shortage": 2.77, "border": -5.45}
"""Weights of a region's features in the log-odds that it is a thing that changed: a logistic regression on drawn places
that were refurnished and on photos of places where nothing was (docs/changes.md)."""

BIAS = -6.8


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


def find_regions(here: PhotoCells, there: PhotoCells, compared: Compared, components: Components) -> list[Region]:
    """Regions of one photo that the other lacks, whatever their confidence.

    Parameters
    ----------
    here, there : PhotoCells
    compared : Compared
        `here` against `there`.
    components : Components
    """
    numbers = components(compared.lost)
    found = []
    for number in range(1, int(numbers.max(initial=0)) + 1):
        cells = numbers == number
        if cells.mean() < SMALLEST:
            continue
        other = np.zeros(there.shape, np.bool_)
        other[compared.expected[0][cells], compared.expected[1][cells]] = True
        near = _grown(cells, 1)
        around = here.cells[_grown(cells, RING[1]) & ~_grown(cells, RING[0] - 1)]
        features = {
            "size": float(np.log(cells.mean())),
            "contrast": _contrast(here.cells[cells], around),
            "shortage": float(compared.shortage[cells].mean()),
            "border": float((near & ~compared.comparable).sum() / max(int((near & ~cells).sum()), 1)),
        }
        label, instead = (int(scores.mean(axis=0).argmax()) for scores in (here.scores[cells], there.scores[other]))
        spot = Spot(*bounding_box(cells, here.extent), float(cells.mean()), cells)
        found.append(Region(spot, label, instead, features, here.cells[cells], around))
    return found


def _contrast(look: Floats, around: Floats) -> float:
    """How unlike its surroundings a region is: 1 less the mean cosine of its cells with those most like them."""
    if not len(around):
        return 0.0
    cosines = np.sort(look @ around.T, axis=1)
    return float(1 - cosines[:, -STEADY:].mean())


def _grown(cells: Booleans, by: int) -> Booleans:
    """The cells and all that are at most `by` rows and columns away."""
    rows, columns = cells.shape
    padded = np.pad(cells, by)
    grown = np.zeros_like(cells)
    for y in range(2 * by + 1):
        for x in range(2 * by + 1):
            grown |= padded[y : y + rows, x : x + columns]
    return grown
