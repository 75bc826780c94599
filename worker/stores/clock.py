"""Revisions: one clock for all maps, so that a map made anew is later than any index of its namesake."""

import sqlalchemy as sa

from worker.stores.tables import CLOCK, MAPS


def read(connection: sa.Connection) -> int:
    """The last revision given out."""
    return int(connection.scalar(sa.select(CLOCK.c.revision)) or 0)


def tick(connection: sa.Connection, map_id: int) -> int:
    """Give a map its next revision, inside a transaction that is written in turn."""
    connection.execute(sa.update(CLOCK).values(revision=CLOCK.c.revision + 1))
    revision = read(connection)
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(revision=revision))
    return revision
