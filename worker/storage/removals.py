"""Deletion: complete, and in portions, so that other writers do not wait for a large one."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import sqlalchemy as sa

from schemas.records import Filters, Removal
from worker.storage import clock, switching
from worker.storage.damage import bury
from worker.storage.filtering import fitting
from worker.storage.kept_queries import drop_oldest
from worker.storage.part import Part
from worker.storage.rows import find_map, find_view
from worker.storage.tables import JOBS, KEPT_QUERIES, MAPS, VIEWS

PORTION = 200
"""Views deleted in one transaction."""


class _Gone(NamedTuple):
    views: int
    images: int
    revision: int


class Removals(Part):
    """See `worker.service.ports.Removals`."""

    def delete_view(self, view_id: str) -> Removal:
        """Remove a view completely; raises NotFound."""
        with self._database.reading() as connection:
            row = find_view(connection, view_id)
        gone = self._remove(row.map_id, [row.seq])
        if gone.views == 0:  # deleted by another call meanwhile
            with self._database.reading() as connection:
                find_view(connection, view_id)
        return Removal(*gone)

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that the filters select at the time of the call; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            fit = [VIEWS.c.map_id == row.id, *fitting(connection, filters, row.id)]
            seqs = list(connection.scalars(sa.select(VIEWS.c.seq).where(*fit).order_by(VIEWS.c.seq)))
        portions = [self._remove(row.id, seqs[start : start + PORTION]) for start in range(0, len(seqs), PORTION)]
        return Removal(
            views=sum(portion.views for portion in portions),
            images=sum(portion.images for portion in portions),
            revision=portions[-1].revision if portions else row.revision,
        )

    def delete_map(self, name: str) -> Removal:
        """Remove a map, its views and their images; raises NotFound."""

        def take_name(connection: sa.Connection) -> int:
            map_id = int(find_map(connection, name).id)
            # So that a later map of this name begins after every index of this one.
            clock.tick(connection, map_id)
            # Without a name no call finds it; its views are deleted next, or by recovery after a crash.
            connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(name=None))
            connection.execute(sa.delete(JOBS).where(JOBS.c.map_id == map_id))
            return map_id

        return self.clear(self._database.freeing(take_name))

    def clear_deleted_maps(self) -> None:
        """Finish deletions of maps that a crash interrupted."""
        with self._database.reading() as connection:
            left = list(connection.scalars(sa.select(MAPS.c.id).where(MAPS.c.name.is_(None))))
        for map_id in left:
            self.clear(map_id)

    def clear(self, map_id: int) -> Removal:
        """Remove a map without a name, by its number."""
        views = images = 0
        queries = 0
        while portion_of := self._database.freeing(
            lambda connection: drop_oldest(connection, map_id, 0, PORTION, matched=None)
        ):
            queries += portion_of
        some = sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == map_id).order_by(VIEWS.c.seq).limit(PORTION)
        while True:
            with self._database.reading() as connection:
                seqs = list(connection.scalars(some))
            if not seqs:
                break
            portion = self._remove(map_id, seqs)
            views, images = views + portion.views, images + portion.images
        self._database.freeing(lambda connection: connection.execute(sa.delete(MAPS).where(MAPS.c.id == map_id)))
        return Removal(views, images, None, queries)

    def _remove(self, map_id: int, seqs: Sequence[int]) -> _Gone:
        """Delete views of a map, then the images that no view needs."""

        def remove(connection: sa.Connection) -> tuple[int, list[str], int]:
            which = VIEWS.c.seq.in_(seqs)
            rows = list(connection.execute(sa.select(VIEWS.c.seq, VIEWS.c.id, VIEWS.c.sha256).where(which)))
            if rows:
                bury(connection, map_id, [row.seq for row in rows])
                # SQLite adds no reference to a table that is there.
                connection.execute(sa.delete(KEPT_QUERIES).where(KEPT_QUERIES.c.seq.in_(seqs)))
                connection.execute(sa.delete(VIEWS).where(which))
                switching.finish_if_done(connection, map_id, datetime.now(UTC))
                if (shadow := connection.scalar(sa.select(MAPS.c.shadow).where(MAPS.c.id == map_id))) is not None:
                    switching.drop_rows(connection, shadow, {row.id for row in rows})
            revision = connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.id == map_id)) or 0
            return len(rows), [row.sha256 for row in rows], int(revision)

        views, digests, revision = self._database.freeing(remove)
        images = self._images.discard(digests)
        self._database.tidy()
        return _Gone(views, images, revision)
