"""Revisions: one clock for all maps, so that a new map is later than every index of a deleted one of its name.

And the time that services of one database tell each other, whose machines' clocks need not agree.
"""

from datetime import UTC, datetime

import sqlalchemy as sa

from worker.storage.tables import CLOCK, MAPS

_EDIT = (
    sa.update(MAPS)
    .where(MAPS.c.id == sa.bindparam("of"))
    .values(edited=MAPS.c.revision, checksum=MAPS.c.checksum)  # which covers neither
)
_NOW = sa.select(sa.func.clock_timestamp())
_LAST = sa.select(CLOCK.c.revision)
_FORWARD = sa.update(CLOCK).values(revision=CLOCK.c.revision + 1)
_GIVE = (
    sa.update(MAPS)
    .where(MAPS.c.id == sa.bindparam("of"))
    .values(revision=sa.bindparam("given"), checksum=MAPS.c.checksum)  # which does not cover the revision
)


def read(connection: sa.Connection) -> int:
    """The last revision given to a map."""
    return int(connection.scalar(_LAST) or 0)


def forward(connection: sa.Connection) -> int:
    """The next revision, which no map gets, inside a transaction that writes in turn."""
    connection.execute(_FORWARD)
    return read(connection)


def tick(connection: sa.Connection, map_id: int) -> int:
    """Give a map its next revision, inside a transaction that writes in turn."""
    revision = forward(connection)
    connection.execute(_GIVE, {"of": map_id, "given": revision})
    return revision


def tick_edited(connection: sa.Connection, map_id: int) -> int:
    """The same, for a change of attributes of views that the map has already."""
    revision = tick(connection, map_id)
    connection.execute(_EDIT, {"of": map_id})
    return revision


def shared_time(connection: sa.Connection) -> datetime:
    """The time by the one clock that all services of the database can read: its server's, or with SQLite, whose
    services share a machine, that machine's."""
    if connection.dialect.name != "postgresql":
        return datetime.now(UTC)
    told: datetime = connection.execute(_NOW).scalar_one()
    return told.astimezone(UTC)
