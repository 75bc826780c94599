"""Estimated position of a query image, from the positions of the views that match it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from schemas.description import Doubles
from schemas.globe import EARTH_RADIUS_M
from schemas.records import Position
from worker.method.positions import distance, is_known, metres

AGREE_M = 25.0
"""Matches further than this from the best one do not count for the estimate, metres."""

MOST_WEIGHT = 0.5
"""Share of the weight that views of a known height need for the estimate to have one."""

SAME_POINT_M = 1e-6
"""Positions at most this far apart are one point: what is left of rounding, metres."""


@dataclass(frozen=True)
class Fix:
    """An estimated position.

    Parameters
    ----------
    position : Position
        Without heading. Its height is that of the views that have one, where these are most of the weight.
    radius_m : float or None
        Weighted root mean square horizontal distance of the agreeing views from `position`. It is no less than the
        distance from the best view to the nearest other position, divided by the number of points that share the
        weight: where one view agrees, the query is known no better than the place is densely mapped. None when there
        is no other position.
    agreeing : tuple of int
        Indices of the matches within `AGREE_M` of the best one, the best included.
    """

    position: Position
    radius_m: float | None
    agreeing: tuple[int, ...]


def locate(positions: Sequence[Position], weights: Sequence[float], around: Sequence[Position] = ()) -> Fix | None:
    """Weighted mean of the positions within `AGREE_M` of the best match's.

    Parameters
    ----------
    positions : sequence of Position
        Positions of the matches, best first.
    weights : sequence of float
        Weight of each match, at least 0; all zero count as all equal.
    around : sequence of Position
        Of other views, which tell how densely the place is mapped.

    Returns
    -------
    Fix or None
        None when the best match has no position.
    """
    if not positions or not is_known(positions[0]):
        return None
    geographic = positions[0].lat is not None
    same_frame = [i for i, p in enumerate(positions) if is_known(p) and (p.lat is not None) == geographic]
    away = np.array([metres(positions[i], positions[0]) for i in same_frame])
    near = np.linalg.norm(away[:, :2], axis=1) <= AGREE_M
    chosen = [i for i, close in zip(same_frame, near, strict=True) if close]
    offsets = away[near]
    share = np.array([weights[i] for i in chosen], np.float64)
    share = share / share.sum() if share.sum() > 0 else np.full(len(chosen), 1 / len(chosen))
    mean = share @ offsets
    spread = float(np.sqrt(share @ ((offsets[:, :2] - mean[:2]) ** 2).sum(axis=1)))
    heights = [positions[i].alt if geographic else positions[i].z for i in chosen]
    known = np.array([height is not None for height in heights])
    told = float(share[known].sum())
    height = float(share[known] @ offsets[known, 2]) / told if told >= MOST_WEIGHT else None
    gaps = [gap for other in around if SAME_POINT_M < (gap := distance(positions[0], other)) < inf]
    radius = max(spread, min(gaps) / _sharing(offsets[:, :2], share)) if gaps else spread
    return Fix(_place(mean, height, positions[0]), radius if radius > SAME_POINT_M else None, tuple(chosen))


def _sharing(points: Doubles, share: Doubles) -> float:
    """Effective number of points that share the weight: the inverse of the sum of squared weights (Kish, 1965).

    1 where one point has all of it, and the number of points where all have the same.
    """
    together = np.linalg.norm(points[:, None] - points, axis=2) <= SAME_POINT_M
    return float(1 / (share @ together @ share))


def _place(offset: Doubles, height: float | None, origin: Position) -> Position:
    if origin.lat is None or origin.lon is None:
        return Position(x=(origin.x or 0.0) + float(offset[0]), y=(origin.y or 0.0) + float(offset[1]), z=height)
    lat = origin.lat + float(np.degrees(offset[1] / EARTH_RADIUS_M))
    # At a pole every longitude is the same point; the guard only keeps the division finite.
    scale = max(float(np.cos(np.radians(origin.lat))), 1e-9)
    lon = origin.lon + float(np.degrees(offset[0] / EARTH_RADIUS_M / scale))
    return Position(lat=max(-90.0, min(90.0, lat)), lon=(lon + 180) % 360 - 180, alt=height)
