"""Coverage of a map: its spots, the directions in which they were photographed, and the gaps between them."""

from collections import defaultdict
from collections.abc import Sequence
from itertools import product

import numpy as np

from schemas.description import Doubles

QUARTERS = {"north": 0.0, "east": 90.0, "south": 180.0, "west": 270.0}
"""Directions in which a place should have been photographed, degrees clockwise from north or +y."""

REACH_DEG = 60.0
"""A view covers the directions up to this far from its own: a quarter is missed by headings that leave it out by more
than the field of a usual camera."""

LONG = 3.0
"""A gap is longer than this many times the median step."""


def spots(points: Doubles, within: float) -> list[list[int]]:
    """Points by spot: each point that none holds yet founds one, and takes all later points near it.

    Parameters
    ----------
    points : float64 of shape (n, d)
        Metres, in the order of enrolment.
    within : float
        Radius of a spot, at least 0, metres.

    Returns
    -------
    list of list of int
        Indices into `points`, ascending; each point is in one spot.
    """
    # A little more: two points that are `within` apart once rounded may lie in cells that are not neighbours.
    side = max(within * (1 + 1e-9), 1e-6)
    cells: defaultdict[tuple[int, ...], list[int]] = defaultdict(list)
    numbers = np.floor(points / side).astype(np.int64)
    for i, cell in enumerate(numbers.tolist()):
        cells[tuple(cell)].append(i)
    steps = np.array(list(product((-1, 0, 1), repeat=points.shape[1])))
    taken = np.zeros(len(points), np.bool_)
    found = []
    for i in range(len(points)):
        if taken[i]:
            continue
        around = [j for cell in (numbers[i] + steps).tolist() for j in cells.get(tuple(cell), ())]
        near = [j for j in around if not taken[j] and np.hypot.reduce(points[j] - points[i]) <= within]
        taken[near] = True
        found.append(sorted({i, *near}))
        taken[i] = True
    return found


def missing_directions(headings: Sequence[float]) -> list[str]:
    """The `QUARTERS` that no heading (degrees) comes within `REACH_DEG` of; none when there is no heading."""
    if not len(headings):
        return []
    # Mostly a few headings of each of thousands of spots: numpy would take ten times as long.
    return [
        name
        for name, wanted in QUARTERS.items()
        if all(abs((heading - wanted + 180) % 360 - 180) > REACH_DEG for heading in headings)
    ]


def gaps(points: Doubles, least: float) -> list[tuple[int, int, float]]:
    """Where points are further apart than is usual among them.

    Parameters
    ----------
    points : float64 of shape (n, d)
        Metres.
    least : float
        Shorter gaps are none, metres.

    Returns
    -------
    list of (int, int, float)
        The two points at the ends of each gap and its length, longest first.

    Notes
    -----
    Edges of the minimum spanning tree (Prim) that are longer than `least` and than `LONG` times the median edge. Such a
    tree joins every point to the others by the shortest hops, whatever the order of enrolment was.
    """
    if len(points) < 3:
        return []
    edges = _spanning_tree(points)
    usual = float(np.median([length for *_, length in edges]))
    long = [edge for edge in edges if edge[2] > max(least, LONG * usual)]
    return sorted(long, key=lambda edge: (-edge[2], edge[:2]))


def _spanning_tree(points: Doubles) -> list[tuple[int, int, float]]:
    count, axes = len(points), np.ascontiguousarray(points.T)
    nearest = np.full(count, np.inf)  # squared distance to the tree; infinite for its own points
    parent = np.zeros(count, np.int64)
    outside = np.ones(count, np.bool_)
    edges, last = [], 0
    for _ in range(count - 1):
        outside[last] = False
        nearest[last] = np.inf
        away = np.square(axes - axes[:, last, None]).sum(axis=0)
        closer = outside & (away < nearest)
        nearest[closer], parent[closer] = away[closer], last
        last = int(np.argmin(nearest))
        edges.append((int(parent[last]), last, float(np.sqrt(nearest[last]))))
    return edges
