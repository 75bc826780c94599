"""Filters as SQL conditions: a bounding box for the database's index, then the exact distance.

Distances on the globe are compared without trigonometry, which SQLite may lack: positions are stored as points on the
unit sphere, and the great-circle distance d is at most r exactly when the chord is at most 2 sin(r / 2R). The square of
half the chord is the haversine of d / R. A box around such a point has no special cases at antimeridian and poles.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import sqlalchemy as sa

from schemas.errors import InvalidParameters
from schemas.globe import chord, unit_vector
from schemas.records import Filters
from schemas.values import spellings
from worker.storage.rows import as_json
from worker.storage.tables import METADATA_PAIRS, VIEWS
from worker.storage.where import fulfilling

_MOST_LISTED = 10

Clause = sa.ColumnElement[bool]


def metadata_pair(key: str, text: str) -> str:
    """The stored form of a key and the text of its value: their SHA-256 (hex)."""
    return hashlib.sha256(as_json([key, text]).encode()).hexdigest()


def metadata_pairs(metadata: Mapping[str, Any]) -> list[str]:
    """The stored pairs of a view: each top-level key with the text of its value."""
    return [metadata_pair(key, text_of(value)) for key, value in metadata.items()]


def text_of(value: object) -> str:
    """The text that finds a value: a string as it is, anything else as compact JSON with sorted keys."""
    if isinstance(value, str):
        return value
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def allowing(connection: sa.Connection, filters: Filters, scope: Sequence[Clause]) -> list[Clause]:
    """Conditions on `views` of all filters but the exclusions; a view must fulfil all of them.

    Parameters
    ----------
    connection : Connection
    filters : Filters
    scope : sequence of conditions
        The views that are filtered: their positions say in which frame `near` is, where the filters do not.

    Raises
    ------
    InvalidParameters
        The views have positions in both frames, or `near` is not a point of theirs.
    """
    conditions: list[Clause] = []
    if filters.near is not None:
        first, second, radius = map(float, filters.near)
        geographic = filters.geographic
        if geographic is None:
            geographic = are_in_degrees(connection, first, second, scope)
        conditions += (_near_degrees if geographic else _near_metres)(first, second, radius)
    if filters.after is not None:
        conditions.append(VIEWS.c.captured_at >= filters.after)
    if filters.before is not None:
        conditions.append(VIEWS.c.captured_at <= filters.before)
    if filters.place is not None:
        conditions.append(VIEWS.c.place.in_(spellings(filters.place)))
    for key, text in filters.metadata.items():
        pair = METADATA_PAIRS.c.pair == metadata_pair(key, text)
        conditions.append(VIEWS.c.seq.in_(sa.select(METADATA_PAIRS.c.seq).where(pair)))
    if filters.where is not None:
        conditions.append(fulfilling(filters.where, connection.dialect.name))
    return conditions


def excluding(
    connection: sa.Connection, filters: Filters, map_id: int | None, among: Sequence[Clause] = ()
) -> list[Clause]:
    """Conditions on `views` of the exclusions; a view that fulfils one of them is left out.

    Parameters
    ----------
    connection : Connection
    filters : Filters
    map_id : int or None
        Map whose newest views `exclude_last` leaves out; None for the newest of all maps.
    among : sequence of conditions
        Without a map, the views of which these are the newest and which `exclude` may name.

    Raises
    ------
    InvalidParameters
        `exclude` names views that the map does not have.
    """
    conditions: list[Clause] = []
    scope: list[Clause] = list(among) if map_id is None else [VIEWS.c.map_id == map_id]
    last = filters.exclude_last
    if isinstance(last, timedelta):
        newest = connection.scalar(sa.select(sa.func.max(VIEWS.c.elapsed_us)).where(*scope))
        if newest is not None:  # back from the newest by the time that passed, whatever the clock said meanwhile
            conditions.append(VIEWS.c.elapsed_us >= newest - last // timedelta(microseconds=1))
    elif last:
        newest_first = sa.select(VIEWS.c.seq).where(*scope).order_by(VIEWS.c.seq.desc())
        oldest = connection.scalar(newest_first.offset(int(last) - 1).limit(1))
        conditions.append(VIEWS.c.seq >= (0 if oldest is None else oldest))
    if filters.exclude:
        where = "there are" if map_id is None else "the map has"
        _refuse_unknown(connection, filters.exclude, scope, where)
        conditions.append(VIEWS.c.id.in_(filters.exclude))
    return conditions


def _refuse_unknown(connection: sa.Connection, ids: Sequence[str], scope: Sequence[Clause], where: str) -> None:
    known = set(connection.scalars(sa.select(VIEWS.c.id).where(VIEWS.c.id.in_(ids), *scope)))
    if unknown := [one for one in dict.fromkeys(ids) if one not in known]:
        listed = ", ".join(unknown[:_MOST_LISTED]) + ("" if len(unknown) <= _MOST_LISTED else ", …")
        raise InvalidParameters.of("exclude", f"{where} no views {listed} ({len(unknown)} of {len(ids)} ids)")


def fitting(
    connection: sa.Connection, filters: Filters, map_id: int | None, scope: Sequence[Clause] = ()
) -> list[Clause]:
    """Conditions on `views` of all filters; a view must fulfil all of them. `scope`: as in `allowing`."""
    allowed = allowing(connection, filters, scope or ([] if map_id is None else [VIEWS.c.map_id == map_id]))
    return allowed + [sa.not_(excluded) for excluded in excluding(connection, filters, map_id, scope)]


def are_in_degrees(connection: sa.Connection, first: float, second: float, scope: Sequence[Clause]) -> bool:
    """Whether positions are in degrees, of which `first` and `second` then have to be a latitude and a longitude."""
    metres, degrees = (
        connection.scalar(sa.select(VIEWS.c.seq).where(column.is_not(None), *scope).limit(1)) is not None
        for column in (VIEWS.c.x, VIEWS.c.globe_z)
    )
    if metres and degrees:
        raise InvalidParameters.of(
            "frame", "is needed: there are positions in metres and in degrees; frame=map or frame=geo says which"
        )
    if degrees and (abs(first) > 90 or abs(second) > 180):
        needed = "needs a latitude within ±90 and a longitude within ±180, as positions here are"
        raise InvalidParameters.of("near", f"{needed} (got {first:g},{second:g})")
    return degrees


def _near_metres(x: float, y: float, radius: float) -> list[Clause]:
    return _near((VIEWS.c.x, VIEWS.c.y), (x, y), radius, slack=1e-6)


def _near_degrees(lat: float, lon: float, radius: float) -> list[Clause]:
    reach = chord(radius)
    if reach is None:  # the whole globe
        return [VIEWS.c.globe_z.is_not(None)]
    # z first: the index has it first, because views of one city differ in it wherever the city lies.
    x, y, z = unit_vector(lat, lon)
    return _near((VIEWS.c.globe_z, VIEWS.c.globe_x, VIEWS.c.globe_y), (z, x, y), reach, slack=1e-12)


def _near(columns: Sequence[sa.Column[float]], centre: Sequence[float], radius: float, slack: float) -> list[Clause]:
    """Conditions for a box, slightly enlarged against rounding, and for the exact distance."""
    reach = radius * (1 + 1e-9) + slack
    box = [column.between(at - reach, at + reach) for column, at in zip(columns, centre, strict=True)]
    squares = [_square(column - at) for column, at in zip(columns, centre, strict=True)]
    return [*box, sum(squares[1:], squares[0]) <= radius * radius]


def _square(difference: sa.ColumnElement[float]) -> sa.ColumnElement[float]:
    """The square; 0 of what is so small that it would end the statement in PostgreSQL, where it is no float64."""
    return sa.case((sa.func.abs(difference) < 1e-150, 0.0), else_=difference * difference)
