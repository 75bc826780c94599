"""Filters of searches over columns in memory: see filter_columns.py."""

import logging
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
import numpy.typing as npt
import sqlalchemy as sa

from schemas.records import Filters, Sequence64
from schemas.where import AllOf, AnyOf, Begins, Compared, Is, Not, Predicate
from worker.storage.database import Database
from worker.storage.filter_columns import Column, Mask, NotExact, Path, read
from worker.storage.filtering import EARTH_RADIUS_M, are_in_degrees
from worker.storage.rows import unit_vector
from worker.storage.tables import MAPS, VIEWS

log = logging.getLogger("revisit")

MOST_BYTES = 128 << 20
"""Of all columns together; those of the map that was filtered least lately go first."""

MOST_MAPS = 100
"""Maps of which it is known at which revision they were filtered."""

SETTLED_S = 2.0
"""Seconds for which a map has to stay as it is before columns are read, which takes longer than some filters in SQL."""

Doubles = npt.NDArray[np.float64]

METRES, GLOBE = ("x", "y"), ("globe_z", "globe_x", "globe_y")

State = tuple[int, int]
"""Revision of a map, and sequence number of its newest view."""


@dataclass(eq=False)
class _Held:
    """The columns of a map in a state that was first met at `since`; None for one that is not to be had."""

    state: State
    since: float
    seqs: Sequence64 | None = None
    columns: dict[Path, Column | None] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return sum(column.size for column in self.columns.values() if column is not None)


class FilterCache:
    """Answers filters from columns in memory, where a map stays as it is. Safe to use from several threads.

    Columns are read in a thread of their own, so that no query waits for them.

    Parameters
    ----------
    database : Database
    most_bytes : int
    settled_s : float
        Seconds for which a map has to stay as it is before columns are read.
    """

    def __init__(self, database: Database, most_bytes: int = MOST_BYTES, settled_s: float = SETTLED_S) -> None:
        self._database, self._most_bytes, self._settled_s = database, most_bytes, settled_s
        self._held: OrderedDict[int, _Held] = OrderedDict()
        self._lock = threading.Lock()
        self._reading: threading.Thread | None = None

    @property
    def size(self) -> int:
        """Bytes of all columns."""
        with self._lock:
            return self._size()

    def wait(self) -> None:
        """Wait until what is being read is there."""
        with self._lock:
            reading = self._reading
        if reading is not None:
            reading.join()

    def only(self, connection: sa.Connection, map_id: int, revision: int, filters: Filters) -> Sequence64 | None:
        """The views that fulfil all filters but the exclusions, ascending; None: ask the database.

        Parameters
        ----------
        connection : Connection
            In a transaction that sees one snapshot.
        map_id, revision : int
            Of a map, as this transaction sees it.
        filters : Filters
            At least one of them.

        Raises
        ------
        InvalidParameters
            As `filtering.allowing`.
        """
        state = revision, _newest(connection, map_id)
        geographic = filters.geographic
        if filters.near is not None and geographic is None:
            first, second, _ = map(float, filters.near)
            geographic = are_in_degrees(connection, first, second, [VIEWS.c.map_id == map_id])
        paths = set(_paths(filters, geographic=bool(geographic)))
        with self._lock:
            held = self._held.get(map_id)
            if held is None or held.state != state:
                held = self._held[map_id] = _Held(state, time.monotonic())
                while len(self._held) > MOST_MAPS:
                    self._held.popitem(last=False)
            self._held.move_to_end(map_id)
            missing = sorted(paths - held.columns.keys())
            if missing:
                if self._reading is None and time.monotonic() - held.since >= self._settled_s:
                    self._reading = threading.Thread(
                        target=self._read, args=(map_id, held, missing), name="revisit-filters", daemon=True
                    )
                    self._reading.start()
                return None
            seqs = held.seqs
            columns = {path: column for path in paths if (column := held.columns[path]) is not None}
        if seqs is None or len(columns) < len(paths):
            return None
        return seqs[_mask(filters, columns, geographic=bool(geographic))]

    def _read(self, map_id: int, held: _Held, paths: Sequence[Path]) -> None:
        """Read columns of a map, unless it has changed; what goes wrong is left to the database to say."""
        try:
            with self._database.reading() as connection:
                revision = connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.id == map_id))
                found = {}
                if (revision, _newest(connection, map_id)) == held.state:
                    found = {path: _column(connection, map_id, path) for path in paths}
            with self._lock:
                if self._held.get(map_id) is held and found:
                    self._keep(map_id, held, found)
        except Exception as error:
            log.warning("what views are filtered by is not kept in memory: %s", error)
            held.since = time.monotonic()
        finally:
            self._reading = None

    def _keep(self, map_id: int, held: _Held, found: Mapping[Path, tuple[Sequence64, Column] | None]) -> None:
        for path, read_now in found.items():
            if read_now is None:
                held.columns[path] = None
                continue
            seqs, held.columns[path] = read_now
            if held.seqs is None:
                held.seqs = seqs
            elif not np.array_equal(seqs, held.seqs):  # one that was never found is gone, without a new revision
                del self._held[map_id]
                return
        while self._size() > self._most_bytes:
            if len(self._held) > 1:
                self._held.popitem(last=False)
            else:
                held.columns = dict.fromkeys(held.columns)

    def _size(self) -> int:
        return sum(held.size for held in self._held.values())


def _newest(connection: sa.Connection, map_id: int) -> int:
    return int(connection.scalar(sa.select(sa.func.max(VIEWS.c.seq)).where(VIEWS.c.map_id == map_id)) or 0)


def _column(connection: sa.Connection, map_id: int, path: Path) -> tuple[Sequence64, Column] | None:
    try:
        return read(connection, map_id, path)
    except NotExact:
        return None


def _paths(filters: Filters, *, geographic: bool) -> Iterator[Path]:
    """The columns that filters need."""
    if filters.near is not None:
        yield from ((name,) for name in (GLOBE if geographic else METRES))
    if filters.after is not None or filters.before is not None:
        yield ("captured_at",)
    if filters.place is not None:
        yield ("place",)
    yield from (("=", key) for key in filters.metadata)
    if filters.where is not None:
        yield from _named(filters.where)


def _named(one: Predicate) -> Iterator[Path]:
    if isinstance(one, AllOf | AnyOf):
        for part in one.conditions:
            yield from _named(part)
    elif isinstance(one, Not):
        yield from _named(one.condition)
    else:
        yield one.path


def _mask(filters: Filters, columns: Mapping[Path, Column], *, geographic: bool) -> Mask:
    """Which views fulfil all filters; at least one is given."""
    masks: list[Mask] = []
    if filters.near is not None:
        masks.append(_near(filters.near, columns, geographic=geographic))
    if filters.after is not None:
        masks.append(columns["captured_at",].compared("$gte", filters.after))
    if filters.before is not None:
        masks.append(columns["captured_at",].compared("$lte", filters.before))
    if filters.place is not None:
        masks.append(columns["place",].equal(filters.place))
    masks += [columns["=", key].equal(text) for key, text in filters.metadata.items()]
    if filters.where is not None:
        masks.append(_fulfilled(filters.where, columns))
    return reduce(np.logical_and, masks)


def _fulfilled(one: Predicate, columns: Mapping[Path, Column]) -> Mask:
    """Which views a condition holds of, with the meaning of `where.fulfilling`."""
    if isinstance(one, AllOf | AnyOf):
        parts = (_fulfilled(part, columns) for part in one.conditions)
        return reduce(np.logical_and if isinstance(one, AllOf) else np.logical_or, parts)
    if isinstance(one, Not):
        return np.logical_not(_fulfilled(one.condition, columns))
    column = columns[one.path]
    if isinstance(one, Is):
        return reduce(np.logical_or, (column.equal(value) for value in one.values))
    if isinstance(one, Compared):
        return column.compared(one.operator, one.bound)
    return column.begins(one.prefix) if isinstance(one, Begins) else column.exists


def _near(near: tuple[float, float, float], columns: Mapping[Path, Column], *, geographic: bool) -> Mask:
    """Which views lie within a radius, by the distances of `filtering`."""
    first, second, radius = map(float, near)
    names: tuple[str, ...] = METRES
    centre = [first, second]
    if geographic:
        half_angle = radius / (2 * EARTH_RADIUS_M)
        if half_angle >= math.pi / 2:
            return columns["globe_z",].exists
        x, y, z = unit_vector(first, second)
        names, centre, radius = GLOBE, [z, x, y], 2 * math.sin(half_angle)
    total: Doubles = np.zeros(len(columns[names[0],].exists))
    with np.errstate(invalid="ignore", over="ignore"):
        for name, at in zip(names, centre, strict=True):  # in the order in which SQL adds
            total += np.square(columns[name,].known_numbers() - at)
        return np.less_equal(total, radius * radius)
