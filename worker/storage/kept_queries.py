"""Queries that matched nothing, kept with a small image of each where the map says so."""

from collections.abc import Sequence
from datetime import datetime

import sqlalchemy as sa

from schemas.description import Description
from schemas.errors import NotFound
from schemas.inbox import KeptQuery
from schemas.recipe import DescriptionRecipe
from worker.storage import checksums
from worker.storage.packing import pack_keypoints, pack_vectors, unpack_floats, unpack_keypoints
from worker.storage.part import Part
from worker.storage.rows import find_map, log
from worker.storage.tables import KEPT_QUERIES, MAPS


def drop_oldest(connection: sa.Connection, map_id: int, keep: int, most: int | None = None) -> int:
    """Delete all but the newest `keep` queries of a map, at most `most` of them; returns how many."""
    own = KEPT_QUERIES.c.map_id == map_id
    newest = sa.select(KEPT_QUERIES.c.id).where(own).order_by(KEPT_QUERIES.c.id.desc())
    # In a map of thousands there is one beyond: its id bounds all that are older.
    first = connection.scalar(newest.offset(keep).limit(1))
    if first is None:
        return 0
    old = sa.select(KEPT_QUERIES.c.id).where(own, KEPT_QUERIES.c.id <= first).order_by(KEPT_QUERIES.c.id).limit(most)
    ids = list(connection.scalars(old))
    connection.execute(sa.delete(KEPT_QUERIES).where(own, KEPT_QUERIES.c.id <= ids[-1]))
    return len(ids)


class KeptQueries(Part):
    """Kept queries of maps. They belong to their map and are deleted with it."""

    def keep(
        self, name: str, query_id: str, recipe: DescriptionRecipe, description: Description, image: bytes, now: datetime
    ) -> None:
        """Keep a query, and drop the oldest beyond what the map keeps; nothing where it keeps none or was deleted."""
        features = description.keypoints
        values = {
            "id": query_id,
            "recipe": recipe.id,
            "queried_at": now,
            "vectors": pack_vectors(description, recipe),
            "keypoints": None if features is None else pack_keypoints(features),
            "image": image,
        }
        with self._database.writing() as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            if row is not None and row.keep_queries:
                connection.execute(sa.insert(KEPT_QUERIES).values(map_id=row.id, **values))
                drop_oldest(connection, row.id, row.keep_queries)

    def newest(self, name: str, most: int) -> tuple[list[KeptQuery], int]:
        """The newest `most` queries of a map, oldest first, and how many are kept; damaged ones are left out.

        Raises
        ------
        NotFound
            There is no such map.
        """
        with self._database.reading() as connection:
            own = KEPT_QUERIES.c.map_id == find_map(connection, name).id
            count = connection.scalar(sa.select(sa.func.count()).select_from(KEPT_QUERIES).where(own)) or 0
            page = sa.select(KEPT_QUERIES).where(own).order_by(KEPT_QUERIES.c.id.desc()).limit(most)
            found = []
            for row in connection.execution_options(yield_per=50).execute(page):
                try:
                    if not checksums.is_whole(KEPT_QUERIES, row, row.checksum):
                        raise ValueError("the row does not fit its checksum")
                    features = None if row.keypoints is None else unpack_keypoints(row.keypoints)
                    found.append(KeptQuery(row.id, row.recipe, row.queried_at, unpack_floats(row.vectors), features))
                except ValueError as error:
                    log.error("kept query %s is damaged and left out: %s", row.id, error)
        return found[::-1], int(count)

    def image(self, name: str, query_id: str) -> bytes:
        """The small image of a kept query, a JPEG; raises NotFound."""
        with self._database.reading() as connection:
            own = KEPT_QUERIES.c.map_id == find_map(connection, name).id
            row = connection.execute(sa.select(KEPT_QUERIES).where(own, KEPT_QUERIES.c.id == query_id)).one_or_none()
        if row is None or not checksums.is_whole(KEPT_QUERIES, row, row.checksum):
            raise NotFound("kept query", query_id)
        return bytes(row.image)

    def delete(self, name: str, query_ids: Sequence[str]) -> int:
        """Delete kept queries of a map; returns how many there were; raises NotFound."""

        def remove(connection: sa.Connection) -> int:
            own = KEPT_QUERIES.c.map_id == find_map(connection, name).id
            which = sa.delete(KEPT_QUERIES).where(own, KEPT_QUERIES.c.id.in_(list(query_ids)))
            return int(connection.execute(which).rowcount)

        return int(self._database.freeing(remove))
