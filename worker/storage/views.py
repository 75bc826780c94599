"""Views: shown, listed, changed."""

import builtins
from collections.abc import Callable, Collection, Sequence
from typing import Any

import sqlalchemy as sa

from schemas.description import Floats
from schemas.errors import Damaged, ImageNotKept, InvalidParameters
from schemas.records import Filters, ViewAttributes, ViewRecord
from worker.storage import clock
from worker.storage.answers import StoredAnswers
from worker.storage.comparisons import outdate
from worker.storage.damage import ATTRIBUTES
from worker.storage.enrolment import keep_pairs
from worker.storage.filtering import fitting
from worker.storage.image_store import needs_image
from worker.storage.packing import unpack_floats
from worker.storage.paging import cursor_after, read_cursor
from worker.storage.part import Part
from worker.storage.rows import (
    COORDINATES,
    VIEW_STATES,
    as_json,
    attribute_columns,
    attributes_of,
    batches,
    change_view,
    find_map,
    find_recipe,
    find_view,
    has_whole_attributes,
    log,
    maps_named,
    view_record,
    view_rows,
    views_of,
)
from worker.storage.tables import COMPARISONS, DESCRIPTIONS, VIEWS

NO_METADATA = as_json({})


class Views(Part):
    """See `worker.service.ports.Views`."""

    def get(self, view_id: str) -> ViewRecord:
        """One view; raises NotFound."""
        with self._database.reading() as connection:
            row = find_view(connection, view_id)
        [record] = self._records([row])
        return record

    def at(self, seqs: Sequence[int], recipe: str | None = None) -> dict[int, ViewRecord]:
        """Views by sequence number, described by their map's recipe or another one; deleted ones are absent."""
        rows: list[sa.Row[Any]] = []
        wanted, by = views_of(by_given=recipe is not None), {} if recipe is None else {"recipe": recipe}
        with self._database.reading() as connection:
            for portion in batches(int(seq) for seq in seqs):
                rows += connection.execute(wanted, {"seqs": portion, **by})
        return {record.seq: record for record in self._records(rows)}

    def list(
        self,
        name: str | None,
        filters: Filters,
        *,
        state: str | None = None,
        newest_first: bool = False,
        cursor: str | None = None,
        limit: int = 50,
        among: Collection[str] | None = None,
    ) -> "tuple[list[ViewRecord], str | None]":
        """A page of views in enrolment order (or reverse), and the cursor of the next.

        `among`: only views of these maps.

        Raises
        ------
        NotFound, InvalidParameters
        """
        order = "newest" if newest_first else "oldest"
        page = view_rows().order_by(VIEWS.c.seq.desc() if newest_first else VIEWS.c.seq).limit(limit + 1)
        if cursor is not None:
            [last] = read_cursor(order, cursor, int)
            page = page.where(VIEWS.c.seq < last if newest_first else VIEWS.c.seq > last)
        if state is not None:
            page = page.where(VIEWS.c.state == state)
        scope = [] if among is None else [VIEWS.c.map_id.in_(maps_named(among))]
        page = page.where(*scope)
        with self._database.reading() as connection:
            map_id = None
            if name is not None:
                map_id = find_map(connection, name).id
                page = page.where(VIEWS.c.map_id == map_id)
                scope.append(VIEWS.c.map_id == map_id)
            rows = [*connection.execute(page.where(*fitting(connection, filters, map_id, scope)))]
        following = cursor_after(order, rows[limit - 1].seq) if len(rows) > limit else None
        return self._records(rows[:limit]), following

    def ranked(
        self,
        name: str,
        filters: Filters,
        score: Callable[[Sequence[str], Floats], Floats],
        *,
        cursor: str | None = None,
        limit: int = 50,
    ) -> "tuple[builtins.list[ViewRecord], str | None]":
        """A page of the described views of a map by a score of their label shares, and the cursor of the next.

        Parameters
        ----------
        score : function
            From the labels and the shares, (n_views, n_labels), to a score of each view. Views with 0 are left out;
            equal ones follow in the order of enrolment.

        Raises
        ------
        NotFound, InvalidParameters
            And what `score` raises.
        """
        last = None if cursor is None else _last_rank(cursor)
        with self._database.reading() as connection:
            row = find_map(connection, name)
            labels = find_recipe(connection, row.recipe).labels
            described = (
                sa.select(DESCRIPTIONS.c.seq, DESCRIPTIONS.c.label_shares)
                .join(VIEWS, VIEWS.c.seq == DESCRIPTIONS.c.seq)
                .where(DESCRIPTIONS.c.recipe == row.recipe, VIEWS.c.state == "ready", VIEWS.c.map_id == row.id)
                .where(*fitting(connection, filters, row.id))
            )
            found = [one for one in connection.execute(described) if len(one.label_shares) == 4 * len(labels)]
            shares = unpack_floats(b"".join(one.label_shares for one in found)).reshape(-1, len(labels))
            scores = score(labels, shares)
            order = sorted((-value, one.seq) for value, one in zip(scores.tolist(), found, strict=True) if value > 0)
            if last is not None:
                order = [key for key in order if key > last]
            page = connection.execute(views_of(), {"seqs": [seq for _, seq in order[:limit]]})
            rows = {view.seq: view for view in page}
        following = (
            cursor_after("words", order[limit - 1][0].hex(), order[limit - 1][1]) if len(order) > limit else None
        )
        return self._records([rows[seq] for _, seq in order[:limit]]), following

    def _records(self, rows: Sequence[sa.Row[Any]]) -> "builtins.list[ViewRecord]":
        """Views from their rows; damaged ones are failed, in the database too."""
        records = [view_record(row) for row in rows]
        damaged = [row for row, record in zip(rows, records, strict=True) if record.state != row.state]
        described = [row for row in damaged if has_whole_attributes(row) and row.state in VIEW_STATES]
        for recipe in {row.recipe for row in described}:
            self._quarantine.descriptions({row.seq: "facts" for row in described if row.recipe == recipe}, recipe)
        self._quarantine.views(row.seq for row in damaged if row not in described)
        return records

    def change(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> ViewRecord:
        """Replace a view's attributes by `change` of them, in one transaction; raises NotFound, Damaged.

        Stored answers to calls with an Idempotency-Key lose what the view had before. When `change` raises, the view
        stays as it was.
        """
        try:
            changed = self._change(view_id, change, None)
        except _AnswersUnread:
            changed = self._change(view_id, change, StoredAnswers(self._database, [view_id]))
        self._database.stain()  # people edit view after view: the journal is emptied for all of them together
        return changed

    def _change(
        self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes], answers: StoredAnswers | None
    ) -> ViewRecord:
        """As `change`; raises _AnswersUnread where stored answers have to be rewritten, and `answers` is None."""
        with self._database.writing() as connection:
            before = find_view(connection, view_id)
            if not has_whole_attributes(before):
                raise Damaged(ATTRIBUTES.format(id=view_id, sha256=str(before.sha256)))
            attributes = change(attributes_of(before))
            columns = attribute_columns(attributes)
            if had := {column: was for column, value in columns.items() if (was := getattr(before, column)) != value}:
                change_view(connection, before, columns)
                keep_pairs(connection, before.seq, attributes)
                connection.execute(sa.delete(COMPARISONS).where(COMPARISONS.c.seq == before.seq))
                if not had.keys().isdisjoint(("place", *COORDINATES)):
                    outdate(connection, before.map_id, [before.seq])
                clock.tick_edited(connection, before.map_id)
                if any(was not in (None, NO_METADATA) for was in had.values()):
                    if answers is None:
                        raise _AnswersUnread
                    answers.update(connection, {view_id: attributes})
            return view_record(find_view(connection, view_id))

    def image(self, view_id: str) -> bytes:
        """The enrolled bytes.

        Raises
        ------
        NotFound, ImageNotKept
        Damaged
            The file is missing or is not what was enrolled.
        """
        with self._database.reading() as connection:
            digest = str(find_view(connection, view_id).sha256)
            kept = sa.select(VIEWS.c.seq).where(VIEWS.c.id == view_id, needs_image(connection))
            if connection.scalar(kept) is None:
                raise ImageNotKept(view_id)
        try:
            return self._images.read(digest)
        except Damaged as error:
            with self._database.reading() as connection:
                find_view(connection, view_id)  # else it was deleted between row and file
            log.error("view %s: %s", view_id, error.detail)
            raise


class _AnswersUnread(Exception):
    """Stored answers have to be rewritten, and were not read yet. They are read before the transaction that writes."""


def _last_rank(cursor: str) -> tuple[float, int]:
    """Negative score and sequence number of the last view of a page; raises InvalidParameters."""
    score, seq = read_cursor("words", cursor, str, int)
    try:
        return float.fromhex(str(score)), int(seq)
    except (ValueError, OverflowError):
        raise InvalidParameters.of("cursor", "is no cursor of this listing; begin again without one") from None
