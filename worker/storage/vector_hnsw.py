"""HNSW indexes of PostgreSQL's searched vectors: built in the background, and their recall measured."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.recipe import DescriptionRecipe
from worker.storage.disk_errors import translated
from worker.storage.part import Part
from worker.storage.rows import find_recipe, log
from worker.storage.tables import MAPS
from worker.storage.vector_search import Scope, nearest, stored_vectors
from worker.storage.vector_tables import SEARCHED_MAPS, SEARCHED_VECTORS, see_extension

LEAST_VIEWS = 1000
"""Views of a map from which HNSW pays; a smaller one is searched exactly."""

MOST_DIMENSIONS = 2000
"""Of a vector that pgvector's HNSW takes."""

SAMPLE, NEIGHBOURS = 50, 50
"""Views that a measurement of recall queries with, and how many nearest ones it compares; the view itself left out."""

EVERY_S = 10.0
"""Seconds between looks for something to do."""

TURN = 0x7265766973697402
"""Key of the advisory lock of the one process that builds."""

_NAME = "searched_hnsw_{searched_id}_{channel}"


class VectorIndexing(Part, retried=False):
    """Builds what HNSW needs. Queries are answered meanwhile, exactly. Only for a prepared PostgreSQL database."""

    _looked_at = float("-inf")

    def step(self, *, now_s: float | None = None) -> bool:
        """Build or measure for one map, if that is due and no other process does; returns whether it was.

        Raises
        ------
        StorageFailed, DiskFull
        """
        now_s = time.monotonic() if now_s is None else now_s
        if now_s - self._looked_at < EVERY_S:
            return False
        self._looked_at = now_s
        with self._alone() as connection:
            if connection is None or not self._next(connection):
                return False
        self._looked_at = float("-inf")
        return True

    @contextmanager
    def _alone(self) -> "Iterator[sa.Connection | None]":
        """A connection whose statements commit by themselves, if no other process builds; else None."""
        with translated("database"), self._database.engine.connect() as plain:
            connection = plain.execution_options(isolation_level="AUTOCOMMIT")
            if not connection.scalar(sa.text(f"SELECT pg_try_advisory_lock({TURN})")):
                yield None
                return
            connection.execute(sa.text("SET lock_timeout = 0"))  # an index is built once nobody uses what it replaces
            try:
                yield connection
            finally:
                connection.invalidate()  # with its lock, and not into the pool

    def _next(self, connection: sa.Connection) -> bool:
        there = _indexes(connection)
        maps = {row.id: row for row in connection.execute(_SEARCHED)}
        every = set(connection.scalars(sa.select(SEARCHED_MAPS.c.id)))
        for name, (searched_id, _, valid) in there.items():
            if searched_id not in every or not valid:  # its map was deleted, or a process was killed while building it
                connection.execute(sa.text(f"DROP INDEX CONCURRENTLY IF EXISTS {name}"))
        built = {(searched_id, channel) for searched_id, channel, valid in there.values() if valid}
        views = {row.searched_id: int(row.views) for row in connection.execute(_VIEWS)}
        for row in maps.values():
            if views.get(row.id, 0) < LEAST_VIEWS:
                continue
            recipe = find_recipe(connection, row.recipe)
            lengths = [channel.length for channel in recipe.parameters.channels.values()]
            lacking = [c for c, size in enumerate(lengths) if (row.id, c) not in built and size <= MOST_DIMENSIONS]
            for channel in lacking:
                self._build(connection, row, channel, lengths[channel], views[row.id])
            if lacking or row.recall is None or views[row.id] >= 2 * row.measured_views:
                self._measure(row, recipe, views[row.id])
                return True
        return False

    def _build(self, connection: sa.Connection, row: sa.Row[Any], channel: int, size: int, views: int) -> None:
        began = time.monotonic()
        name = _NAME.format(searched_id=row.id, channel=channel)
        schema = connection.scalar(_SCHEMA)  # types and operators by their full names: this statement stands alone
        connection.execute(
            sa.text(
                f"CREATE INDEX CONCURRENTLY {name} ON {SEARCHED_VECTORS.name} "
                f"USING hnsw ((vector::{schema}.vector({size})) {schema}.vector_l2_ops) "
                f"WHERE searched_id = {row.id} AND channel = {channel}"
            )
        )
        connection.execute(sa.text(f"ANALYZE {SEARCHED_VECTORS.name}"))  # or the planner does not know that it pays
        log.info("map %s: HNSW of %d views was built in %.1f s", row.name, views, time.monotonic() - began)

    def _measure(self, row: sa.Row[Any], recipe: DescriptionRecipe, views: int) -> None:
        """Compare HNSW with the exact search, by views of the map; keep and log the recall."""
        with self._database.reading() as connection:
            see_extension(connection)
            seqs = np.array(list(connection.scalars(_every(row.id, max(1, views // SAMPLE)))), np.int64)
            vectors, damaged = stored_vectors(connection, seqs, recipe.id)
            seqs = np.setdiff1d(seqs, damaged)
            shares, start = [], 0
            for number, channel in enumerate(recipe.parameters.channels.values()):
                scope = Scope(row.id, number, channel.length, (), on_views=False)
                part = slice(start, start + channel.length)
                start += channel.length
                for seq, vector in zip(seqs, vectors, strict=True):
                    exact, found = (
                        set(nearest(connection, scope, vector[part], NEIGHBOURS + 1, approximate=by).tolist()) - {seq}
                        for by in (False, True)
                    )
                    shares.append(len(exact & found) / len(exact) if exact else 1.0)
        if not shares:
            return
        recall = float(np.mean(shares))
        measured = {"recall": recall, "measured_views": views, "measured_at": datetime.now(UTC)}
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(sa.update(SEARCHED_MAPS).where(SEARCHED_MAPS.c.id == row.id).values(**measured))
        log.info("map %s: HNSW finds %.1f %% of the %d nearest views", row.name, 100 * recall, NEIGHBOURS)


_SEARCHED = (
    sa.select(SEARCHED_MAPS, MAPS.c.name)
    .join(MAPS, (MAPS.c.id == SEARCHED_MAPS.c.map_id) & (MAPS.c.recipe == SEARCHED_MAPS.c.recipe))
    .where(MAPS.c.name.is_not(None), SEARCHED_MAPS.c.revision.is_not(None))
    .order_by(SEARCHED_MAPS.c.id)
)
_VIEWS = (
    sa.select(SEARCHED_VECTORS.c.searched_id, sa.func.count().label("views"))
    .where(SEARCHED_VECTORS.c.channel == 0)
    .group_by(SEARCHED_VECTORS.c.searched_id)
)
_SCHEMA = sa.text(
    "SELECT quote_ident(nspname) FROM pg_extension JOIN pg_namespace ON pg_namespace.oid = extnamespace "
    "WHERE extname = 'vector'"
)
_INDEXES = sa.text(
    "SELECT relname, indisvalid FROM pg_index JOIN pg_class ON pg_class.oid = indexrelid "
    f"WHERE indrelid = to_regclass('{SEARCHED_VECTORS.name}') AND relname LIKE 'searched_hnsw_%'"
)


def _indexes(connection: sa.Connection) -> dict[str, tuple[int, int, bool]]:
    """By name, each HNSW index: number of its map by a recipe, channel, and whether it is whole."""
    found = {}
    for row in connection.execute(_INDEXES):
        if parts := re.fullmatch(r"searched_hnsw_(\d+)_(\d+)", row.relname):
            found[row.relname] = int(parts[1]), int(parts[2]), bool(row.indisvalid)
    return found


def _every(searched_id: int, step: int) -> sa.Select[Any]:
    """Every `step`-th view of a map by enrolment order, at most `SAMPLE`."""
    number = sa.func.row_number().over(order_by=SEARCHED_VECTORS.c.seq).label("number")
    of = SEARCHED_VECTORS.c.searched_id == searched_id, SEARCHED_VECTORS.c.channel == 0
    numbered = sa.select(SEARCHED_VECTORS.c.seq, number).where(*of).subquery()
    return sa.select(numbered.c.seq).where(numbered.c.number % step == 0).order_by(numbered.c.seq).limit(SAMPLE)
