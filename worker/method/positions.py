"""Positions: whether they are known, and how far apart they lie, in metres."""

from math import cos, hypot, inf, radians

from schemas.globe import EARTH_RADIUS_M
from schemas.records import Position


def is_known(position: Position) -> bool:
    """Whether a position has coordinates; a heading alone is none."""
    return position.x is not None or position.lat is not None


def distance(one: Position, other: Position) -> float:
    """Metres between two positions, with the height where both have one; infinite when they cannot be compared."""
    if not _comparable(one, other):
        return inf
    east, north, _ = metres(other, one)
    return hypot(east, north, climb(one, other))


def climb(one: Position, other: Position) -> float:
    """Metres by which the heights of two positions differ, at least 0; 0 when they cannot be compared."""
    if not _comparable(one, other):
        return 0.0
    below, above = (one.z, other.z) if one.lat is None else (one.alt, other.alt)
    return 0.0 if below is None or above is None else abs(above - below)


def _comparable(one: Position, other: Position) -> bool:
    """Whether both have coordinates, and in one frame."""
    return is_known(one) and is_known(other) and (one.lat is None) == (other.lat is None)


def metres(position: Position, origin: Position) -> tuple[float, float, float]:
    """A position in metres, (east or x, north or y, height): horizontally from the origin, the height as it stands.

    The two are in one frame. Coordinates that are not known count as 0.
    """
    if position.lat is not None and position.lon is not None and origin.lat is not None and origin.lon is not None:
        east = (position.lon - origin.lon + 180) % 360 - 180
        scale = cos(radians(origin.lat))
        return (
            radians(east) * EARTH_RADIUS_M * scale,
            radians(position.lat - origin.lat) * EARTH_RADIUS_M,
            position.alt or 0.0,
        )
    return (position.x or 0.0) - (origin.x or 0.0), (position.y or 0.0) - (origin.y or 0.0), position.z or 0.0
