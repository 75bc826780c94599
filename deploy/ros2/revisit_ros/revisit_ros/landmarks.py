"""Places as landmarks: a number for each that stays the same for good, as RTAB-Map wants them."""

import hashlib
from dataclasses import dataclass

from revisit_client.wire import QueryAnswer, View

from revisit_ros.pose import UNKNOWN, diagonal

VIEW_RADIUS_M = 0.15
"""How far a camera is from the view that it is just being enrolled as: what is left of clocks and rounding."""


@dataclass(frozen=True)
class Landmark:
    """A place that the camera stands at.

    Parameters
    ----------
    id : int
        1 to 2**31 - 1.
    name : str
        What the number stands for.
    variance : float
        Of the camera's distance from it along each axis, m^2.
    """

    id: int
    name: str
    variance: float

    def covariance(self) -> list[float]:
        """6 x 6, row by row: a point, whose rotation says nothing."""
        return diagonal((self.variance,) * 3 + (UNKNOWN,) * 3)


def number_of(name: str) -> int:
    """The number of a name, 1 to 2**31 - 1: the same on every machine and in every run."""
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big") % (2**31 - 1) + 1


def name_of(view: View) -> str:
    """What a view is a landmark of: its place, or itself where it has none."""
    return f"{view.map}/{view.place}" if view.place is not None else view.id


class Landmarks:
    """Makes landmarks of names. Of two names with the same number only the first gets one.

    Parameters
    ----------
    radius_m : float
        How far from its place a camera may be where the service does not say.
    """

    def __init__(self, radius_m: float) -> None:
        self._radius_m = radius_m
        self._names: dict[int, str] = {}

    def recognised(self, answer: QueryAnswer) -> Landmark | None:
        """The landmark of a matched answer; None where nothing matched."""
        if answer.status != "matched" or not answer.matches:
            return None
        radius = None if answer.estimate is None else answer.estimate.radius_m
        return self._landmark(name_of(answer.matches[0].view), radius or self._radius_m)

    def enrolled(self, view: View) -> Landmark | None:
        """The landmark of a view that was enrolled just now."""
        return self._landmark(name_of(view), VIEW_RADIUS_M if view.place is None else self._radius_m)

    def _landmark(self, name: str, radius: float) -> Landmark | None:
        """The landmark of a name, with a radius in metres; None where another name has its number already."""
        number = number_of(name)
        if self._names.setdefault(number, name) != name:
            return None
        return Landmark(number, name, radius**2 / 2)
