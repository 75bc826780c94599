"""A plain model of what the service must hold: dictionaries, and filters written down a second time."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

EARTH_RADIUS_M = 6_371_008.8
EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
CLOSE_S = 0.1
"""No `exclude_last` is sent whose limit is that near to the age of a view: how time is kept would decide."""

PLACES = ("gate", "yard", "Straße 7", "столовая", "回廊")
FLOORS = (0, 1, 2)


class Violation(Exception):
    """The service is not what it promised to be; the text says where."""


def require(true: object, what: str) -> None:
    """Raise Violation unless `true`."""
    if not true:
        raise Violation(what)


@dataclass(frozen=True)
class Attributes:
    """What a caller said of an image.

    Parameters
    ----------
    place : str or None
    position : mapping of str to float
        Coordinates as on the wire; empty without a position.
    captured_at : datetime or None
    metadata : mapping
    """

    place: str | None = None
    position: Mapping[str, float] = field(default_factory=dict)
    captured_at: datetime | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def parameters(self) -> dict[str, str]:
        """As parameters of an enrolment."""
        given = {name: repr(value) for name, value in self.position.items()}
        if self.place is not None:
            given["place"] = self.place
        if self.captured_at is not None:
            given["captured_at"] = self.captured_at.isoformat()
        if self.metadata:
            given["metadata"] = json.dumps(self.metadata)
        return given


@dataclass
class Known:
    """A view that was acknowledged.

    Parameters
    ----------
    id, map : str
    number : int
        Of its image.
    digest : str
        SHA-256 of its image.
    attributes : Attributes
    enrolled_at : datetime
        As the service said.
    """

    id: str
    map: str
    number: int
    digest: str
    attributes: Attributes
    enrolled_at: datetime

    def compare(self, shown: Mapping[str, Any]) -> None:
        """Compare with the view as the service shows it; raises Violation."""
        position = {k: v for k, v in (shown["position"] or {}).items() if v is not None}
        captured = None if shown["captured_at"] is None else datetime.fromisoformat(shown["captured_at"])
        pairs = {
            "id": (self.id, shown["id"]),
            "map": (self.map, shown["map"]),
            "place": (self.attributes.place, shown["place"]),
            "position": (dict(self.attributes.position), position),
            "captured_at": (self.attributes.captured_at, captured),
            "metadata": (dict(self.attributes.metadata), shown["metadata"]),
            "sha256": (self.digest, shown["image"]["sha256"]),
            "enrolled_at": (self.enrolled_at, datetime.fromisoformat(shown["enrolled_at"])),
        }
        for name, (kept, seen) in pairs.items():
            require(kept == seen, f"view {self.id}: {name} is {seen!r} and was acknowledged as {kept!r}")


@dataclass
class KnownMap:
    """A map: its views in the order of their enrolment, its recipe, and the jobs of its shadow and of a switch that is
    not awaited yet."""

    name: str
    recipe: str
    ranking: str
    revision: int = 0
    views: dict[str, Known] = field(default_factory=dict)
    jobs: list[str] = field(default_factory=list)
    switch: str | None = None
    shadow: str | None = None
    untimely: bool = False  # a clock jumped while it had views


@dataclass(frozen=True)
class Narrowed:
    """A filter: as parameters of a call, and as a function of all views of a map to those that it leaves."""

    parameters: Mapping[str, str]
    left: Callable[[Sequence[Known]], list[Known]]


def draw_attributes(chance: np.random.Generator) -> Attributes:
    """What a caller says: anything from nothing to everything."""
    position: dict[str, float] = {}
    frame = chance.integers(3)
    if frame == 1:
        position = {"x": float(chance.integers(-20, 20)), "y": float(chance.integers(-20, 20))}
        if chance.random() < 0.3:
            position["z"] = round(float(chance.normal()), 3)
    elif frame == 2:
        position = {"lat": round(float(chance.uniform(51, 51.01)), 7), "lon": round(float(chance.uniform(6, 6.02)), 7)}
    if position and chance.random() < 0.5:
        position["heading"] = float(chance.integers(360))
    return Attributes(
        place=None if chance.random() < 0.3 else str(chance.choice(PLACES)),
        position=position,
        captured_at=None if chance.random() < 0.4 else EPOCH + timedelta(seconds=int(chance.integers(1000))),
        metadata={}
        if chance.random() < 0.5
        else {"floor": int(chance.choice(FLOORS)), "by": "Zoë", "deep": [{"a": 1}]},
    )


def draw_filter(chance: np.random.Generator, of: KnownMap) -> Narrowed:
    """One filter, or two at once, or none."""
    drawn = [_one_filter(chance, of) for _ in range(int(chance.integers(0, 3)))]
    parameters: dict[str, str] = {}
    kept = []
    for one in drawn:
        twice = parameters.keys() & one.parameters.keys() or {"after", "before"} <= {*parameters, *one.parameters}
        if not twice:
            parameters |= one.parameters
            kept.append(one)

    def left(views: Sequence[Known]) -> list[Known]:
        # Each looks at all views: `exclude_last` leaves out the newest of the map, not the newest of what is left.
        ids = [{view.id for view in one.left(views)} for one in kept]
        return [view for view in views if all(view.id in fitting for fitting in ids)]

    return Narrowed(parameters, left)


def _one_filter(chance: np.random.Generator, of: KnownMap) -> Narrowed:
    views = list(of.views.values())
    kind = int(chance.integers(8))
    if kind == 0:
        place = str(chance.choice(PLACES))
        return _each({"place": place}, lambda view: view.attributes.place == place)
    if kind == 1:
        floor = int(chance.choice(FLOORS))
        return _each({"metadata.floor": str(floor)}, lambda view: view.attributes.metadata.get("floor") == floor)
    if kind == 2:
        x, y, radius = (
            float(chance.integers(-20, 20)),
            float(chance.integers(-20, 20)),
            int(chance.integers(1, 20)) + 0.5,
        )
        metric = {"near": f"{x},{y},{radius}", "frame": "map"}  # the maps have positions in both frames
        return _each(metric, lambda view: _metres(view.attributes.position, x, y) <= radius)
    if kind == 3:
        lat, lon, reach = round(float(chance.uniform(51, 51.01)), 7), 6.01, float(chance.uniform(50, 900))
        geographic = {"near": f"{lat},{lon},{reach}", "frame": "geo"}
        return _each(geographic, lambda view: _great_circle(view.attributes.position, lat, lon) <= reach)
    if kind == 4:
        moment = EPOCH + timedelta(seconds=int(chance.integers(1000)))
        name = str(chance.choice(["after", "before"]))
        sign = 1 if name == "after" else -1
        return _each(
            {name: moment.isoformat()},
            lambda view: (
                view.attributes.captured_at is not None
                and sign * (view.attributes.captured_at - moment).total_seconds() >= 0
            ),
        )
    if kind == 5 and views:
        gone = [views[i].id for i in chance.integers(len(views), size=int(chance.integers(1, 4)))]
        return _each({"exclude": ",".join(gone)}, lambda view: view.id not in gone)
    if kind == 6 and not of.untimely:
        seconds = round(float(chance.uniform(0.01, 20)), 3)
        ages = [(views[-1].enrolled_at - view.enrolled_at).total_seconds() for view in views]
        if all(abs(age - seconds) > CLOSE_S for age in ages):
            return Narrowed({"exclude_last": f"{seconds}s"}, lambda all_: _not_within(all_, timedelta(seconds=seconds)))
    count = int(chance.integers(1, 12))
    return Narrowed({"exclude_last": str(count)}, lambda all_: list(all_[:-count]))


def _each(parameters: Mapping[str, str], fits: Callable[[Known], bool]) -> Narrowed:
    return Narrowed(parameters, lambda views: [view for view in views if fits(view)])


def _not_within(views: Sequence[Known], span: timedelta) -> list[Known]:
    return [view for view in views if view.enrolled_at < views[-1].enrolled_at - span]


def _metres(position: Mapping[str, float], x: float, y: float) -> float:
    return math.hypot(position["x"] - x, position["y"] - y) if "x" in position else math.inf


def _great_circle(position: Mapping[str, float], lat: float, lon: float) -> float:
    """Distance in metres by the haversine formula."""
    if "lat" not in position:
        return math.inf
    one, other = math.radians(lat), math.radians(position["lat"])
    turn = math.radians(position["lon"] - lon)
    half = math.sin((other - one) / 2) ** 2 + math.cos(one) * math.cos(other) * math.sin(turn / 2) ** 2
    return 2 * EARTH_RADIUS_M * math.asin(math.sqrt(half))


def draw_patch(chance: np.random.Generator, attributes: Attributes) -> tuple[dict[str, Any], Attributes]:
    """A merge patch (RFC 7396) of a view, and what is said of the view after it."""
    kind = int(chance.integers(4))
    if kind == 0:
        place = None if chance.random() < 0.3 else str(chance.choice(PLACES))
        return {"place": place}, replace(attributes, place=place)
    if kind == 1:
        floor = int(chance.choice(FLOORS))
        return {"metadata": {"floor": floor, "deep": None}}, replace(
            attributes, metadata={k: v for k, v in attributes.metadata.items() if k != "deep"} | {"floor": floor}
        )
    if kind == 2:
        moment = None if chance.random() < 0.3 else EPOCH + timedelta(seconds=int(chance.integers(1000)))
        return {"captured_at": None if moment is None else moment.isoformat()}, replace(attributes, captured_at=moment)
    if chance.random() < 0.3:
        return {"position": None}, replace(attributes, position={})
    moved = {"x": float(chance.integers(-20, 20)), "y": float(chance.integers(-20, 20))}
    cleared = {name: None for name in attributes.position if name not in ("x", "y")}
    return {"position": moved | cleared}, replace(attributes, position=moved)
