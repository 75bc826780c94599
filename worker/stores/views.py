"""Views: shown, listed, corrected, deleted."""

from collections.abc import Sequence

import sqlalchemy as sa

from schemas.errors import NotFound
from schemas.records import Filters, Removal, Said, ViewRecord
from worker.stores import clock, switching
from worker.stores.enrolment import keep_pairs
from worker.stores.filtering import fitting
from worker.stores.paging import cursor_after, read_cursor
from worker.stores.part import Part
from worker.stores.rows import batches, find_map, find_view, said_columns, view_record, view_rows
from worker.stores.tables import MAPS, TOMBSTONES, VIEWS


class Views(Part):
    """The promises of `schemas.ports.Store` about views."""

    def view(self, view_id: str) -> ViewRecord:
        """One view; raises NotFound."""
        with self._database.reading() as connection:
            return view_record(find_view(connection, view_id))

    def views_at(self, seqs: Sequence[int]) -> dict[int, ViewRecord]:
        """Views by sequence number; those deleted meanwhile are absent."""
        found: dict[int, ViewRecord] = {}
        with self._database.reading() as connection:
            for portion in batches(int(seq) for seq in seqs):
                rows = connection.execute(view_rows().where(VIEWS.c.seq.in_(portion)))
                found.update({row.seq: view_record(row) for row in rows})
        return found

    def views(
        self,
        name: str | None,
        filters: Filters,
        *,
        state: str | None = None,
        newest_first: bool = False,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[list[ViewRecord], str | None]:
        """A page of views in enrolment order, and the cursor of the next; see `Store.views`."""
        order = "newest" if newest_first else "oldest"
        page = view_rows().order_by(VIEWS.c.seq.desc() if newest_first else VIEWS.c.seq).limit(limit + 1)
        if cursor is not None:
            [last] = read_cursor(order, cursor, int)
            page = page.where(VIEWS.c.seq < last if newest_first else VIEWS.c.seq > last)
        if state is not None:
            page = page.where(VIEWS.c.state == state)
        with self._database.reading() as connection:
            map_id = None
            if name is not None:
                map_id = find_map(connection, name).id
                page = page.where(VIEWS.c.map_id == map_id)
            rows = list(connection.execute(page.where(*fitting(connection, filters, map_id))))
        following = cursor_after(order, rows[limit - 1].seq) if len(rows) > limit else None
        return [view_record(row) for row in rows[:limit]], following

    def patch(self, view_id: str, said: Said) -> ViewRecord:
        """Replace what was said about a view; raises NotFound."""
        with self._database.writing() as connection:
            before = find_view(connection, view_id)
            columns = said_columns(said)
            if any(value != getattr(before, column) for column, value in columns.items()):
                connection.execute(sa.update(VIEWS).where(VIEWS.c.seq == before.seq).values(**columns))
                keep_pairs(connection, before.seq, said)
                clock.tick(connection, before.map_id)
            return view_record(find_view(connection, view_id))

    def delete_view(self, view_id: str) -> Removal:
        """Remove a view completely; raises NotFound."""
        with self._database.writing() as connection:
            row = find_view(connection, view_id)
            digests, revision = self._remove(connection, row.map_id, VIEWS.c.seq == row.seq)
        return Removal(views=1, pictures=self._pictures.discard(digests), revision=revision)

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that fit; raises NotFound."""
        with self._database.writing() as connection:
            row = find_map(connection, name)
            fit = sa.and_(VIEWS.c.map_id == row.id, *fitting(connection, filters, row.id))
            digests, revision = self._remove(connection, row.id, fit)
        return Removal(views=len(digests), pictures=self._pictures.discard(digests), revision=revision)

    def _remove(self, connection: sa.Connection, map_id: int, which: sa.ColumnElement[bool]) -> tuple[list[str], int]:
        """Delete views of a map; returns the digests of their pictures and the map's revision."""
        rows = list(connection.execute(sa.select(VIEWS.c.seq, VIEWS.c.sha256).where(which)))
        if rows:
            revision = clock.tick(connection, map_id)
            connection.execute(
                sa.insert(TOMBSTONES), [{"seq": row.seq, "map_id": map_id, "revision": revision} for row in rows]
            )
            for seqs in batches(row.seq for row in rows):
                connection.execute(sa.delete(VIEWS).where(VIEWS.c.seq.in_(seqs)))
            switching.finish_if_done(connection, map_id)
        revision = int(connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.id == map_id)) or 0)
        return [row.sha256 for row in rows], revision

    def picture(self, view_id: str) -> bytes:
        """The enrolled picture, byte for byte; raises NotFound."""
        with self._database.reading() as connection:
            digest = connection.scalar(sa.select(VIEWS.c.sha256).where(VIEWS.c.id == view_id))
        if digest is None:
            raise NotFound("view", view_id)
        try:
            return self._pictures.read(digest)
        except FileNotFoundError:  # deleted between row and file
            hint = "the view was deleted, or its file was removed by hand: then enrol the picture again"
            raise NotFound("picture of view", view_id, hint) from None
