"""The order of enrolment, in ids and in time: neither goes back when the clock of the machine does."""

import secrets
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import sqlalchemy as sa
from uuid6 import UUID, uuid7

from worker.storage.tables import MAPS, VIEWS

_NEWEST = sa.select(VIEWS.c.seq, VIEWS.c.id, VIEWS.c.elapsed_us).order_by(VIEWS.c.seq.desc()).limit(1)
_OF_MAP = sa.select(sa.func.max(VIEWS.c.elapsed_us)).where(VIEWS.c.map_id == sa.bindparam("of"))
_PRESENT = sa.select(  # a look into an index for each map; of all views at once there is none
    sa.func.max(
        sa.select(sa.func.max(VIEWS.c.elapsed_us).label("elapsed_us"))
        .where(VIEWS.c.map_id == MAPS.c.id)
        .correlate(MAPS)
        .scalar_subquery()
    )
).select_from(MAPS)
_ENROLLED_LAST = (
    sa.select(VIEWS.c.enrolled_at)
    .where(VIEWS.c.elapsed_us == sa.bindparam("present"))
    .order_by(VIEWS.c.seq.desc())
    .limit(1)
)
_MICROSECOND = timedelta(microseconds=1)
_RANDOM_BITS = 74
_TIME_SHIFT = 80  # RFC 9562, section 5.7: 48 bits of milliseconds stand first


class _Last(NamedTuple):
    seq: int
    elapsed_us: int
    steady_s: float


class EnrolmentOrder:
    """Gives each new view an id and an elapsed time that are not before those of the view enrolled before it.

    The elapsed time of a view is the sum of the times between consecutive enrolments up to it, of all maps. Since an
    enrolment of this object it is measured by a steady clock, also when other services enrolled meanwhile; otherwise it
    is the difference of the times by the machines' clocks, and 0 when that went back.

    Views that were restored come after those in ids and numbers, and before the one that was enrolled last in time (see
    `restoring.py`): when they were enrolled, perhaps long ago and elsewhere, counts for no other view.
    """

    def __init__(self) -> None:
        self._last: _Last | None = None

    def following(
        self, connection: sa.Connection, map_id: int, now: datetime, steady_s: float | None
    ) -> tuple[str, int]:
        """Id and elapsed time (microseconds) of a view that is enrolled now; inside a transaction that writes in turn.

        Parameters
        ----------
        connection : Connection
        map_id : int
        now : datetime
            By the clock of the machine.
        steady_s : float or None
            Reading of a steady clock, in seconds; None when there is none.
        """
        newest = connection.execute(_NEWEST).one_or_none()
        elapsed_us = self._elapsed_us(connection, newest, map_id, now, steady_s)
        return following_id(None if newest is None else newest.id), elapsed_us

    def note(self, seq: int, elapsed_us: int, steady_s: float | None) -> None:
        """Remember the view that was just stored."""
        self._last = None if steady_s is None else _Last(seq, elapsed_us, steady_s)

    def _elapsed_us(
        self, connection: sa.Connection, newest: Any, map_id: int, now: datetime, steady_s: float | None
    ) -> int:
        last = self._last
        if last is None or steady_s is None:
            return _by_the_machines_clock(connection, now)
        own = int(last.elapsed_us) + max(0, round((steady_s - last.steady_s) * 1e6))
        if newest is None or newest.seq <= last.seq:
            return own
        # Beyond that is what a service enrolled whose clock had been ahead.
        return max(own, int(newest.elapsed_us), int(connection.scalar(_OF_MAP, {"of": map_id}) or own))


def present(connection: sa.Connection) -> int | None:
    """The elapsed time of the view enrolled last, of all maps; None: there is none."""
    elapsed_us: int | None = connection.scalar(_PRESENT)
    return elapsed_us


def _by_the_machines_clock(connection: sa.Connection, now: datetime) -> int:
    elapsed_us = present(connection)
    if elapsed_us is None:
        return 0
    enrolled_at = connection.scalars(_ENROLLED_LAST, {"present": elapsed_us}).one()
    return elapsed_us + max(0, int((now - enrolled_at) // _MICROSECOND))


def following_id(previous: str | None) -> str:
    """A new UUIDv7 that sorts after another one, even when the clock went back behind it."""
    made = uuid7()
    if previous is None or str(made) > previous:
        return str(made)
    milliseconds = (UUID(previous).int >> _TIME_SHIFT) + 1
    return str(UUID(int=(milliseconds << _TIME_SHIFT) | secrets.randbits(_RANDOM_BITS), version=7))
