"""How findings name the places of views, and which views are taken together."""

import math
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import Doubles
from schemas.globe import EARTH_RADIUS_M
from schemas.records import Position
from worker.method import coverage
from worker.method.positions import is_known, metres


class View(Protocol):
    """A view and what is known of it besides its image."""

    @property
    def id(self) -> str:
        """Its id."""
        ...

    @property
    def known(self) -> KnownView:
        """Its place and its position."""
        ...


V = TypeVar("V", bound=View)


def by_place(views: Sequence[V], same_place_m: float) -> list[list[V]]:
    """Views by the name of their place, and those without a name by spot.

    Views without a name and a position are in no group.
    """
    named: dict[str, list[V]] = {}
    unnamed = []
    for view in views:
        if view.known.name is None:
            unnamed.append(view)
        else:
            named.setdefault(view.known.name, []).append(view)
    groups = list(named.values())
    for geographic in (False, True):
        groups += by_spot(in_frame(unnamed, geographic), same_place_m)
    return groups


def in_frame(views: Sequence[V], geographic: bool) -> list[V]:
    """Views with a position in degrees, or in metres."""
    return [
        view for view in views if is_known(view.known.position) and (view.known.position.lat is not None) == geographic
    ]


def by_spot(views: Sequence[V], within: float) -> list[list[V]]:
    """Views that lie within some metres of the first one of their group; all have positions in one frame."""
    return [[views[i] for i in spot] for spot in coverage.spots(points_of(views), within)]


def points_of(views: Sequence[V]) -> Doubles:
    """Positions in metres, float64: of shape (views, 2), from the first one; of degrees of shape (views, 3), from the
    centre of the earth: laid flat, what lies far from the first would come out too short or too long."""
    if views and views[0].known.position.lat is not None:
        degrees = np.array([(view.known.position.lat, view.known.position.lon) for view in views], np.float64)
        lat, lon = np.radians(degrees).T
        return EARTH_RADIUS_M * np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    return np.array([metres(view.known.position, views[0].known.position)[:2] for view in views]).reshape(-1, 2)


def along(straight: float, geographic: bool) -> float:
    """The way over the ground between two of these points, metres, by the straight line between them."""
    return 2 * EARTH_RADIUS_M * math.asin(min(straight / (2 * EARTH_RADIUS_M), 1.0)) if geographic else straight


def names_of(group: Sequence[View]) -> tuple[str, ...]:
    """The name of a group's place, where it has one."""
    return () if group[0].known.name is None else (group[0].known.name,)


def known_position(view: View) -> Position | None:
    """Where a view was taken, where that is known."""
    return view.known.position if is_known(view.known.position) else None


def label(view: View) -> str:
    """How a finding names the place of a view."""
    if view.known.name is not None:
        return repr(view.known.name)
    where = known_position(view)
    return f"the view {view.id}" if where is None else f"the spot at {coordinates(where)}"


def coordinates(position: Position) -> str:
    """A position in words."""
    if position.lat is not None:
        return f"lat {position.lat:.6f}, lon {position.lon:.6f}"
    return f"x {position.x:.1f}, y {position.y:.1f}"


def listed(names: Sequence[str]) -> str:
    """Names in a row of words."""
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"
