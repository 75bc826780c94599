"""Filters of searches over columns in memory: see filter_columns.py."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.description import Doubles
from schemas.globe import chord, unit_vector
from schemas.records import Filters, Sequence64
from schemas.values import spellings
from schemas.where import AllOf, AnyOf, Begins, Compared, Is, Not, Predicate
from worker.storage.database import Database
from worker.storage.filter_columns import Column, Mask, NotExact, Path, read
from worker.storage.filtering import are_in_degrees
from worker.storage.tables import MAPS, TOMBSTONES, VIEWS

log = logging.getLogger("revisit")

MOST_BYTES = 128 << 20
"""Bytes of all columns together; the columns of the map that was filtered least recently go first."""

MOST_MAPS = 100
"""Maps that are kept in mind, with or without columns; the one that was filtered least recently goes first."""

SETTLED_S = 2.0
"""Seconds without a change of attributes in a map before its columns are read: reading them takes longer than some
filters in SQL, and the next change makes it useless."""

KEPT_S = 600.0
"""Seconds after which columns are read anew: a process of an earlier version, which may run beside this one, does not
say that it changed attributes."""

MOST_FURTHER = 2000
"""A query itself adds up to this many views that were enrolled since the columns were last used. With more of them, the
columns are read anew in the background."""

METRES, GLOBE = ("x", "y"), ("globe_z", "globe_x", "globe_y")


@dataclass(frozen=True, eq=False)
class _Columns:
    """Columns of a map's views as of a revision, with the views up to `newest`, a sequence number.

    None stands for a field that has a number which is not exact: the database compares it.
    """

    revision: int
    newest: int
    seqs: Sequence64
    columns: Mapping[Path, Column | None]

    @property
    def state(self) -> tuple[int, int]:
        """Greater for a later state of the map. An enrolment shows in `newest` before it has a revision."""
        return self.revision, self.newest

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return sum(column.size for column in self.columns.values() if column is not None)


@dataclass(eq=False)
class _MapColumns:
    """The columns of one map.

    Attributes of its views last changed at the revision `edited`, which was first seen at `since`, by a steady clock.
    """

    edited: int
    since: float
    known: _Columns | None = None

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return 0 if self.known is None else self.known.size


class FilterCache:
    """Answers filters from columns in memory. Safe to use from several threads.

    Columns are read in a thread of their own, so that no query waits for them. A query adds what was enrolled since and
    takes out what was deleted. Where attributes of a view changed, all are read anew.

    Parameters
    ----------
    database : Database
    most_bytes : int
    settled_s : float
        Seconds for which no attribute may have changed before columns are read.
    kept_s : float
        Seconds after which columns are read anew.
    """

    def __init__(
        self, database: Database, most_bytes: int = MOST_BYTES, settled_s: float = SETTLED_S, kept_s: float = KEPT_S
    ) -> None:
        self._database, self._most_bytes, self._settled_s = database, most_bytes, settled_s
        self._kept_s = kept_s
        self._maps: OrderedDict[int, _MapColumns] = OrderedDict()
        self._lock = threading.Lock()
        self._reading: threading.Thread | None = None

    @property
    def size(self) -> int:
        """Bytes of all columns."""
        with self._lock:
            return self._size()

    def wait(self) -> None:
        """Wait for the columns that are being read in the background."""
        with self._lock:
            reading = self._reading
        if reading is not None:
            reading.join()

    def only(self, connection: sa.Connection, map_row: sa.Row[Any], filters: Filters) -> Sequence64 | None:
        """The views that fulfil all filters but the exclusions, ascending; None: ask the database.

        Parameters
        ----------
        connection : Connection
            In a transaction that sees one snapshot.
        map_row : Row
            The row of the map, as this transaction sees it.
        filters : Filters
            At least one of them.

        Raises
        ------
        InvalidParameters
            As `filtering.allowing`.
        """
        geographic = filters.geographic
        if filters.near is not None and geographic is None:
            first, second, _ = map(float, filters.near)
            geographic = are_in_degrees(connection, first, second, [VIEWS.c.map_id == map_row.id])
        if not isinstance(map_row.edited, int):
            return None  # damaged
        paths = set(_paths(filters, geographic=bool(geographic)))
        held = self._of_map(map_row)
        before = held.known
        state = int(map_row.revision), _newest(connection, map_row.id)
        if held.edited != map_row.edited or (before is not None and state < before.state):
            return None  # this transaction began before the columns were read
        known = None if before is None else _up_to(connection, map_row, before)
        with self._lock:
            if held.known is before:  # unless another query has brought them further
                held.known = known
                self._keep_to_bound()
            missing = paths if known is None else paths - known.columns.keys()
            if missing:
                self._begin_reading(map_row.id, held, sorted(missing))
                return None
        assert known is not None
        columns = {path: column for path in paths if (column := known.columns[path]) is not None}
        if len(columns) < len(paths):
            return None
        try:
            return known.seqs[_mask(filters, columns, geographic=bool(geographic))]
        except NotExact:
            return None

    def _of_map(self, map_row: sa.Row[Any]) -> _MapColumns:
        """The columns of a map; begun anew when attributes of its views changed, or after `kept_s`."""
        now = time.monotonic()
        with self._lock:
            held = self._maps.get(map_row.id)
            if held is None or held.edited < map_row.edited or now - held.since > self._kept_s:
                held = self._maps[map_row.id] = _MapColumns(int(map_row.edited), now)
                while len(self._maps) > MOST_MAPS:
                    self._maps.popitem(last=False)
            self._maps.move_to_end(map_row.id)
            return held

    def _begin_reading(self, map_id: int, held: _MapColumns, paths: Sequence[Path]) -> None:
        """Read columns in the background, unless some are being read already or attributes changed a moment ago."""
        if self._reading is None and time.monotonic() - held.since >= self._settled_s:
            self._reading = threading.Thread(
                target=self._read, args=(map_id, held, paths), name="revisit-filters", daemon=True
            )
            self._reading.start()

    def _read(self, map_id: int, held: _MapColumns, paths: Sequence[Path]) -> None:
        """Read columns of a map, unless attributes changed meanwhile. Errors are only logged: queries go on by SQL."""
        try:
            with self._database.reading() as connection:
                map_row = connection.execute(sa.select(MAPS).where(MAPS.c.id == map_id)).one_or_none()
                if map_row is None or map_row.edited != held.edited:
                    return
                before = held.known
                known = None if before is None else _up_to(connection, map_row, before)
                known = _with(connection, map_row, known, paths)
            with self._lock:
                if self._maps.get(map_id) is held:
                    held.known = known
                    self._keep_to_bound()
        except Exception as error:
            log.warning("what views are filtered by is not kept in memory: %s", error)
            held.since = time.monotonic()
        finally:
            self._reading = None

    def _keep_to_bound(self) -> None:
        """Forget the maps that were filtered least recently, and the columns of the last one that is left."""
        while self._size() > self._most_bytes:
            if len(self._maps) > 1:
                self._maps.popitem(last=False)
                continue
            for held in self._maps.values():
                assert held.known is not None
                held.known = replace(held.known, columns=dict.fromkeys(held.known.columns))

    def _size(self) -> int:
        return sum(held.size for held in self._maps.values())


def _up_to(connection: sa.Connection, map_row: sa.Row[Any], known: _Columns) -> _Columns | None:
    """Columns brought to the revision of a transaction: with what was enrolled since, without what was deleted.

    None where more than `MOST_FURTHER` views were enrolled.
    """
    newest = _newest(connection, map_row.id)
    if newest > known.newest:
        later = VIEWS.c.map_id == map_row.id, VIEWS.c.seq > known.newest
        if int(connection.scalar(sa.select(sa.func.count()).select_from(VIEWS).where(*later)) or 0) > MOST_FURTHER:
            return None
        known = _with_further(connection, map_row, known)
    if map_row.revision > known.revision:
        known = _without_gone(connection, map_row, known)
    return replace(known, revision=int(map_row.revision), newest=newest)


def _with_further(connection: sa.Connection, map_row: sa.Row[Any], known: _Columns) -> _Columns:
    """Columns with the views that were enrolled after `known.newest`."""
    columns = dict(known.columns)
    further: Sequence64 | None = None
    for path, column in known.columns.items():
        found = None if column is None else _column(connection, map_row.id, path, known.newest)
        if found is None or column is None:
            columns[path] = None
        else:
            further, columns[path] = found[0], column.with_further(found[1])
    return known if further is None else replace(known, seqs=np.concatenate([known.seqs, further]), columns=columns)


def _without_gone(connection: sa.Connection, map_row: sa.Row[Any], known: _Columns) -> _Columns:
    """Columns without the views that were deleted since."""
    buried = TOMBSTONES.c.map_id == map_row.id, TOMBSTONES.c.revision > known.revision
    left = sa.select(TOMBSTONES.c.seq).where(*buried).where(~sa.exists().where(VIEWS.c.seq == TOMBSTONES.c.seq))
    seqs = np.fromiter(connection.scalars(left), np.int64)
    if len(seqs) == 0:
        return known
    gone = np.isin(known.seqs, seqs)
    columns = {path: None if column is None else column.without(gone) for path, column in known.columns.items()}
    return replace(known, seqs=known.seqs[~gone], columns=columns)


def _with(connection: sa.Connection, map_row: sa.Row[Any], known: _Columns | None, paths: Sequence[Path]) -> _Columns:
    """Columns with those of further fields, as a transaction sees them."""
    found = {path: _column(connection, map_row.id, path) for path in paths}
    seqs = next((one[0] for one in found.values() if one is not None), None)
    columns = {path: None if one is None else one[1] for path, one in found.items()}
    if known is not None and (seqs is None or np.array_equal(seqs, known.seqs)):
        return replace(known, columns={**known.columns, **columns})
    if seqs is None:
        seqs = np.zeros(0, np.int64)
    return _Columns(int(map_row.revision), _newest(connection, map_row.id), seqs, columns)


def _newest(connection: sa.Connection, map_id: int) -> int:
    return int(connection.scalar(sa.select(sa.func.max(VIEWS.c.seq)).where(VIEWS.c.map_id == map_id)) or 0)


def _column(connection: sa.Connection, map_id: int, path: Path, after: int = 0) -> tuple[Sequence64, Column] | None:
    try:
        return read(connection, map_id, path, after)
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
        yield from _fields_of(filters.where)


def _fields_of(predicate: Predicate) -> Iterator[Path]:
    """The fields that a condition names."""
    if isinstance(predicate, AllOf | AnyOf):
        for part in predicate.conditions:
            yield from _fields_of(part)
    elif isinstance(predicate, Not):
        yield from _fields_of(predicate.condition)
    else:
        yield predicate.path


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
        masks.append(reduce(np.logical_or, map(columns["place",].equal, spellings(filters.place))))
    masks += [columns["=", key].equal(text) for key, text in filters.metadata.items()]
    if filters.where is not None:
        masks.append(_fulfilled(filters.where, columns))
    return reduce(np.logical_and, masks)


def _fulfilled(predicate: Predicate, columns: Mapping[Path, Column]) -> Mask:
    """Which views a condition holds of, with the meaning of `where.fulfilling`."""
    if isinstance(predicate, AllOf | AnyOf):
        parts = (_fulfilled(part, columns) for part in predicate.conditions)
        return reduce(np.logical_and if isinstance(predicate, AllOf) else np.logical_or, parts)
    if isinstance(predicate, Not):
        return np.logical_not(_fulfilled(predicate.condition, columns))
    column = columns[predicate.path]
    if isinstance(predicate, Is):
        return reduce(np.logical_or, (column.equal(value) for value in predicate.values))
    if isinstance(predicate, Compared):
        return column.compared(predicate.operator, predicate.bound)
    return column.begins(predicate.prefix) if isinstance(predicate, Begins) else column.exists


def _near(near: tuple[float, float, float], columns: Mapping[Path, Column], *, geographic: bool) -> Mask:
    """Which views lie within a radius, by the distances of `filtering`."""
    first, second, radius = map(float, near)
    names: tuple[str, ...] = METRES
    centre = [first, second]
    if geographic:
        reach = chord(radius)
        if reach is None:  # the whole globe
            return columns["globe_z",].exists
        x, y, z = unit_vector(first, second)
        names, centre, radius = GLOBE, [z, x, y], reach
    total: Doubles = np.zeros(len(columns[names[0],].exists))
    with np.errstate(invalid="ignore", over="ignore"):
        for name, value in zip(names, centre, strict=True):  # in the order in which SQL adds
            total += np.square(columns[name,].known_numbers() - value)
        return np.less_equal(total, radius * radius)
