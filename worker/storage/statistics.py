"""Sizes of the database for the metrics: maps, queues, bytes."""

from collections import defaultdict
from datetime import datetime
from pathlib import Path

import sqlalchemy as sa

from schemas.statistics import MapStatistics, QueueStatistics, StoreStatistics
from worker.storage.database import Database
from worker.storage.maps import STATES
from worker.storage.tables import COMPARISONS, DESCRIPTIONS, JOBS, MAPS, VIEWS

KINDS = ("describe", "recipe", "shadow", "vocabulary", "snapshot", "import")

_COUNT = sa.func.count()
_VIEWS = sa.select(VIEWS.c.map_id, VIEWS.c.state, _COUNT, sa.func.sum(VIEWS.c.byte_count)).group_by(
    VIEWS.c.map_id, VIEWS.c.state
)
_JOBS = (
    sa.select(JOBS.c.kind, JOBS.c.background, JOBS.c.state, _COUNT, sa.func.min(JOBS.c.created_at))
    .where(JOBS.c.kind.in_(KINDS), JOBS.c.state.in_(("waiting", "running")))
    .group_by(JOBS.c.kind, JOBS.c.background, JOBS.c.state)
)
_DESCRIBED = (
    sa.select(MAPS.c.id, _COUNT)
    .join(DESCRIPTIONS, (DESCRIPTIONS.c.map_id == MAPS.c.id) & (DESCRIPTIONS.c.recipe == MAPS.c.recipe))
    .group_by(MAPS.c.id)
)
_COMPARED = (
    sa.select(MAPS.c.id, _COUNT)
    .join(COMPARISONS, (COMPARISONS.c.map_id == MAPS.c.id) & (COMPARISONS.c.recipe == MAPS.c.recipe))
    .group_by(MAPS.c.id)
)


def read(database: Database, now: datetime, sample: int) -> StoreStatistics:
    """Count everything, in one snapshot; reads every view, so it takes longer the more there are.

    Parameters
    ----------
    database : Database
    now : datetime
    sample : int
        Views of a map that are compared at most.
    """
    views: defaultdict[int, dict[str, int]] = defaultdict(lambda: dict.fromkeys(STATES, 0))
    image_bytes: defaultdict[int, int] = defaultdict(int)
    with database.reading() as connection:
        for map_id, state, count, total in connection.execute(_VIEWS):
            views[map_id][state] = count
            image_bytes[map_id] += int(total or 0)
        described = {row[0]: row[1] for row in connection.execute(_DESCRIBED)}
        compared = {row[0]: row[1] for row in connection.execute(_COMPARED)}
        maps = tuple(
            MapStatistics(
                row.name,
                int(row.revision),
                dict(views[row.id]),
                image_bytes[row.id],
                max(0, min(described.get(row.id, 0), sample) - compared.get(row.id, 0)),
            )
            for row in connection.execute(
                sa.select(MAPS.c.id, MAPS.c.name, MAPS.c.revision).where(MAPS.c.name.is_not(None)).order_by(MAPS.c.name)
            )
        )
        queues = _queues(connection, now)
        size = _size(connection)
    return StoreStatistics(maps, queues, size, None if database.space is None else database.space.inodes())


def _queues(connection: sa.Connection, now: datetime) -> tuple[QueueStatistics, ...]:
    found: dict[str, dict[str, tuple[int, datetime]]] = {kind: {} for kind in ("describe", "redescribe", *KINDS[1:])}
    for kind, background, state, count, oldest in connection.execute(_JOBS):
        named = "redescribe" if kind == "describe" and background else kind
        found[named][state] = count, oldest
    return tuple(
        QueueStatistics(
            kind,
            states.get("waiting", (0, now))[0],
            states.get("running", (0, now))[0],
            max(0.0, (now - states.get("waiting", (0, now))[1]).total_seconds()),
        )
        for kind, states in found.items()
    )


def _size(connection: sa.Connection) -> int:
    """Bytes of the database on disk, the log of SQLite included."""
    if connection.dialect.name == "postgresql":
        return int(connection.scalar(sa.text("SELECT pg_database_size(current_database())")) or 0)
    file = Path(connection.engine.url.database or "")
    parts = (file.with_name(file.name + suffix) for suffix in ("", "-wal"))
    return sum(part.stat().st_size for part in parts if part.exists())
