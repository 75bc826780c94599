"""The order of enrolment, in ids and in time: neither goes back when the clock of the machine does."""

import secrets
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import sqlalchemy as sa
from uuid6 import UUID, uuid7

from worker.storage.tables import VIEWS

_NEWEST = sa.select(VIEWS.c.seq, VIEWS.c.id, VIEWS.c.elapsed_us, VIEWS.c.enrolled_at).order_by(VIEWS.c.seq.desc())
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
    """

    def __init__(self) -> None:
        self._last: _Last | None = None

    def following(self, connection: sa.Connection, now: datetime, steady_s: float | None) -> tuple[str, int]:
        """Id and elapsed time (microseconds) of a view that is enrolled now; inside a transaction that writes in turn.

        Parameters
        ----------
        connection : Connection
        now : datetime
            By the clock of the machine.
        steady_s : float or None
            Reading of a steady clock, in seconds; None when there is none.
        """
        newest = connection.execute(_NEWEST.limit(1)).one_or_none()
        return following_id(None if newest is None else newest.id), self._elapsed_us(newest, now, steady_s)

    def note(self, seq: int, elapsed_us: int, steady_s: float | None) -> None:
        """Remember the view that was just stored."""
        self._last = None if steady_s is None else _Last(seq, elapsed_us, steady_s)

    def _elapsed_us(self, newest: Any, now: datetime, steady_s: float | None) -> int:
        last = self._last
        if last is not None and steady_s is not None:
            own = int(last.elapsed_us) + max(0, round((steady_s - last.steady_s) * 1e6))
            # Beyond that is what was restored since, or enrolled by a service whose clock had been ahead.
            if newest is None or newest.seq <= last.seq or newest.elapsed_us <= own:
                return own
        if newest is None:
            return 0
        passed = int((now - newest.enrolled_at) // _MICROSECOND)
        return int(newest.elapsed_us) + max(0, passed)


def following_id(previous: str | None) -> str:
    """A new UUIDv7 that sorts after another one, even when the clock went back behind it."""
    made = uuid7()
    if previous is None or str(made) > previous:
        return str(made)
    milliseconds = (UUID(previous).int >> _TIME_SHIFT) + 1
    return str(UUID(int=(milliseconds << _TIME_SHIFT) | secrets.randbits(_RANDOM_BITS), version=7))
