"""Selections of views for a search, and places."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.errors import Damaged
from schemas.records import Filters, PlaceRecord, Position, Selection, Sequence64
from worker.storage.database import Database
from worker.storage.filter_cache import FilterCache
from worker.storage.filtering import allowing, excluding
from worker.storage.image_store import ImageStore
from worker.storage.paging import cursor_after, read_cursor
from worker.storage.part import Part
from worker.storage.rows import find_map, maps_named
from worker.storage.tables import MAPS, VIEWS

BY_PLACE = "places"

MEANS = ("x", "y", "z", "alt", "globe_x", "globe_y", "globe_z")


class Listings(Part):
    """See `worker.service.ports.Listings`."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._columns = FilterCache(database)

    def close(self) -> None:
        """Wait for what reads in the background."""
        self._columns.wait()

    def select(self, name: str, filters: Filters) -> Selection:
        """The views of a map that filters select, as sequence numbers; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            plain = replace(filters, exclude_last=None, exclude=())
            only = None
            if plain not in (Filters(), Filters(geographic=filters.geographic)):
                only = self._columns.only(connection, row, plain)
            if only is None:
                return selected(connection, row.id, filters)
            rest = selected(connection, row.id, Filters(exclude_last=filters.exclude_last, exclude=filters.exclude))
            return replace(rest, only=only)

    def places(
        self, name: str | None, cursor: str | None, limit: int, among: Collection[str] | None = None
    ) -> tuple[list[PlaceRecord], str | None]:
        """A page of places by map and name, and the cursor of the next; `among`: only places of these maps."""
        means = [sa.func.avg(VIEWS.c[column]).label(column) for column in MEANS]
        page = (
            sa.select(
                MAPS.c.name.label("map"),
                VIEWS.c.place,
                sa.func.count().label("views"),
                sa.func.max(VIEWS.c.enrolled_at, type_=VIEWS.c.enrolled_at.type).label("last"),
                *means,
            )
            .join(MAPS, MAPS.c.id == VIEWS.c.map_id)
            .where(VIEWS.c.place.is_not(None), MAPS.c.name.is_not(None))
            .where(sa.func.coalesce(VIEWS.c.failure_code, "") != Damaged.code)
            .group_by(MAPS.c.name, VIEWS.c.place)
            .order_by(MAPS.c.name, VIEWS.c.place)
            .limit(limit + 1)
        )
        if among is not None:
            page = page.where(VIEWS.c.map_id.in_(maps_named(among)))
        if cursor is not None:
            last_map, last_place = read_cursor(BY_PLACE, cursor, str, str)
            later = sa.and_(MAPS.c.name == last_map, VIEWS.c.place > last_place)
            page = page.where(sa.or_(MAPS.c.name > last_map, later))
        with self._database.reading() as connection:
            if name is not None:
                page = page.where(VIEWS.c.map_id == find_map(connection, name).id)
            rows = list(connection.execute(page))
        following = cursor_after(BY_PLACE, rows[limit - 1].map, rows[limit - 1].place) if len(rows) > limit else None
        places = [
            PlaceRecord(row.map, row.place, row.views, _mean_position(row), row.last)
            for row in rows[:limit]
            if _is_text(row.place)
        ]
        return places, following


def selected(connection: sa.Connection, map_id: int, filters: Filters) -> Selection:
    """The views of a map that filters select, as sequence numbers; raises InvalidParameters."""
    of_map = VIEWS.c.map_id == map_id
    only = None
    allowed = allowing(connection, filters, [of_map])
    if allowed:
        only = _ascending(connection, [of_map, *allowed])
    # Each by itself: a search that leaves out the newest views comes with every frame of a robot.
    never = [_ascending(connection, [of_map, e]) for e in excluding(connection, filters, map_id)]
    return Selection(only, np.unique(np.concatenate([np.zeros(0, np.int64), *never])))


def _is_text(place: str) -> bool:
    """Whether a stored name can be shown; one of damaged bytes cannot, and `revisit doctor` says whose it is."""
    try:
        return bool(place.encode())
    except (UnicodeEncodeError, AttributeError):
        return False


def _mean_position(row: sa.Row[Any]) -> Position:
    """Mean position of a place; in metres where views have both frames."""
    if row.x is not None:
        return Position(x=row.x, y=row.y, z=row.z)
    # The mean of points on the sphere: that of 179 and -179 degrees is not 0.
    if row.globe_x is None or math.hypot(row.globe_x, row.globe_y, row.globe_z) < 1e-9:
        return Position()
    lat = math.degrees(math.atan2(row.globe_z, math.hypot(row.globe_x, row.globe_y)))
    return Position(lat=lat, lon=math.degrees(math.atan2(row.globe_y, row.globe_x)), alt=row.alt)


def _ascending(connection: sa.Connection, conditions: Sequence[sa.ColumnElement[bool]]) -> Sequence64:
    """Sequence numbers, ascending, of the views that fulfil all conditions.

    They are read as one text: a row for each takes four times as long.
    """
    listed = sa.func.aggregate_strings(sa.cast(VIEWS.c.seq, sa.Text), ",")
    text = connection.scalar(sa.select(listed).where(*conditions))
    return np.sort(np.array([] if text is None else np.fromstring(text, np.int64, sep=","), np.int64))
