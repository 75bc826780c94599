"""The earth as a sphere: its radius, points on it, and distances along it."""

import math

EARTH_RADIUS_M = 6_371_008.8
"""Mean radius of WGS 84, (2a + b) / 3, in metres (IUGG)."""


def unit_vector(lat: float, lon: float) -> tuple[float, float, float]:
    """Degrees as a point (x, y, z) on the unit sphere, which has no seam at 180 degrees and no poles."""
    phi, theta = math.radians(lat), math.radians(lon)
    return math.cos(phi) * math.cos(theta), math.cos(phi) * math.sin(theta), math.sin(phi)


def chord(distance_m: float) -> float | None:
    """The straight line between two points of the unit sphere that lie a great-circle distance apart.

    Parameters
    ----------
    distance_m : float
        On the earth, in metres, at least 0.

    Returns
    -------
    float or None
        2 sin(d / 2R), below 2; None from half the earth's circumference on, which no two points exceed.
    """
    half_angle = distance_m / (2 * EARTH_RADIUS_M)
    return None if half_angle >= math.pi / 2 else 2 * math.sin(half_angle)
