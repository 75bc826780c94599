"""Queries that matched nothing, or a view that they look unlike, kept with a small image where the map says so."""

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from schemas.errors import NotFound
from schemas.inbox import KeptQuery, QueryToKeep
from worker.storage import checksums
from worker.storage.packing import pack_keypoints, pack_vectors, unpack_floats, unpack_keypoints
from worker.storage.part import Part
from worker.storage.rows import blur_of, find_map, log
from worker.storage.tables import KEPT_QUERIES, MAPS, VIEWS

PATIENCE_S = 1.0
"""Seconds that a query may wait for others that write, to be kept before it is answered."""


def drop_oldest(
    connection: sa.Connection, map_id: int, keep: int, most: int | None = None, *, matched: bool | None = False
) -> int:
    """Delete all but the newest `keep` queries of a map, at most `most` of them; returns how many.

    `matched`: of those that matched a view, or of those that matched nothing; None: of both together.
    """
    own = sa.and_(KEPT_QUERIES.c.map_id == map_id, _of_kind(matched))
    newest = sa.select(*_ORDER).where(own).order_by(*_NEWEST_FIRST)
    # In a map of thousands there is one beyond: its place in the order bounds all that are older.
    first = connection.execute(newest.offset(keep).limit(1)).one_or_none()
    if first is None:
        return 0
    old = sa.select(*_ORDER).where(own, _up_to(first)).order_by(*_ORDER).limit(most)
    rows = list(connection.execute(old))
    connection.execute(sa.delete(KEPT_QUERIES).where(own, _up_to(rows[-1])))
    return len(rows)


_ORDER = KEPT_QUERIES.c.number, KEPT_QUERIES.c.id
_NEWEST_FIRST = KEPT_QUERIES.c.number.desc(), KEPT_QUERIES.c.id.desc()


def _up_to(row: Any) -> sa.ColumnElement[bool]:
    """SQL condition that a kept query is this one, or was kept before it."""
    same = sa.and_(KEPT_QUERIES.c.number == row.number, KEPT_QUERIES.c.id <= row.id)
    return sa.or_(KEPT_QUERIES.c.number < row.number, same)


def _of_kind(matched: bool | None) -> sa.ColumnElement[bool]:
    if matched is None:
        return sa.true()
    return KEPT_QUERIES.c.seq.is_not(None) if matched else KEPT_QUERIES.c.seq.is_(None)


class KeptQueries(Part):
    """Kept queries of maps. They belong to their map, and to the view that they matched, and are deleted with it."""

    def keep(self, name: str, query: QueryToKeep) -> None:
        """Keep a query of a map, and drop the oldest of its kind beyond what the map keeps.

        Nothing is kept where the map keeps none of this kind or blurs other things than are blurred in the query, or
        where the map or the view that it matched was deleted.

        Raises
        ------
        DiskFull, StorageFailed
            It cannot be stored now, or others have been writing for `PATIENCE_S`.
        """
        features, seq = query.description.keypoints, None if query.match is None else query.match[0]
        values = {
            "id": query.id,
            "recipe": query.recipe.id,
            "queried_at": query.queried_at,
            "vectors": pack_vectors(query.description, query.recipe),
            "keypoints": None if features is None else pack_keypoints(features),
            "image": query.image,
            "seq": seq,
            "score": None if query.match is None else float(query.match[1]),
        }
        with self._database.writing(patience_s=PATIENCE_S) as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            if row is None or not (most := row.keep_queries if seq is None else row.keep_matches):
                return
            if blur_of(row) != query.blurred:
                return
            if seq is not None and connection.scalar(sa.select(VIEWS.c.seq).where(VIEWS.c.seq == seq)) is None:
                return
            # Ids are sortable by the clock of the process that answered; another's, or a clock set back, is behind.
            last = sa.select(sa.func.max(KEPT_QUERIES.c.number)).where(KEPT_QUERIES.c.map_id == row.id)
            number = (connection.scalar(last) or 0) + 1
            connection.execute(sa.insert(KEPT_QUERIES).values(map_id=row.id, number=number, **values))
            dropped = drop_oldest(connection, row.id, most, matched=seq is not None)
        if dropped:
            self._database.stain()

    def newest(self, name: str, most: int, *, matched: bool | None = False) -> tuple[list[KeptQuery], int]:
        """The newest `most` queries of a map, oldest first, and how many are kept; damaged ones are left out.

        Parameters
        ----------
        matched : bool or None
            Those that matched a view, or those that matched nothing; None: both together.

        Raises
        ------
        NotFound
            There is no such map.
        """
        with self._database.reading() as connection:
            own = sa.and_(KEPT_QUERIES.c.map_id == find_map(connection, name).id, _of_kind(matched))
            count = connection.scalar(sa.select(sa.func.count()).select_from(KEPT_QUERIES).where(own)) or 0
            page = sa.select(KEPT_QUERIES).where(own).order_by(*_NEWEST_FIRST).limit(most)
            found = []
            for row in connection.execution_options(yield_per=50).execute(page):
                try:
                    found.append(_kept(row))
                except ValueError as error:
                    log.error("kept query %s is damaged and left out: %s", row.id, error)
        return found[::-1], int(count)

    def image(self, name: str, query_id: str) -> bytes:
        """The small image of a kept query, a JPEG; raises NotFound."""
        with self._database.reading() as connection:
            own = KEPT_QUERIES.c.map_id == find_map(connection, name).id
            row = connection.execute(sa.select(KEPT_QUERIES).where(own, KEPT_QUERIES.c.id == query_id)).one_or_none()
        if row is None or not checksums.is_whole(KEPT_QUERIES, row):
            raise NotFound("kept query", query_id)
        return bytes(row.image)

    def delete(self, name: str, query_ids: Sequence[str]) -> int:
        """Delete kept queries of a map; returns how many there were; raises NotFound."""

        def remove(connection: sa.Connection) -> int:
            own = KEPT_QUERIES.c.map_id == find_map(connection, name).id
            which = sa.delete(KEPT_QUERIES).where(own, KEPT_QUERIES.c.id.in_(list(query_ids)))
            return int(connection.execute(which).rowcount)

        removed = int(self._database.freeing(remove))
        self._database.scrub()
        return removed


def _kept(row: sa.Row[Any]) -> KeptQuery:
    """A kept query from its row; raises ValueError when that is damaged."""
    if not checksums.is_whole(KEPT_QUERIES, row):
        raise ValueError("the row does not fit its checksum")
    features = None if row.keypoints is None else unpack_keypoints(row.keypoints)
    return KeptQuery(row.id, row.recipe, row.queried_at, unpack_floats(row.vectors), features, row.seq, row.score)
