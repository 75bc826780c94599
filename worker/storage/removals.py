"""Deletion: complete, and in portions, so that other writers do not wait for a large one."""

import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import sqlalchemy as sa

from schemas.errors import Conflict, DiskFull, StorageFailed
from schemas.records import Filters
from schemas.removal import Holding, Removal
from worker.storage import clock, deleted_images, forgetting, switching
from worker.storage.answers import StoredAnswers
from worker.storage.comparisons import outdate
from worker.storage.damage import bury
from worker.storage.database import Database
from worker.storage.filtering import fitting
from worker.storage.image_files import Discarded
from worker.storage.image_store import ImageStore
from worker.storage.kept_queries import drop_oldest
from worker.storage.part import Part
from worker.storage.rows import find_map, find_view, log
from worker.storage.tables import DAY_SCORES, DESCRIPTIONS, JOBS, KEPT_QUERIES, MAPS, VIEWS

PORTION = 200
"""Views deleted in one transaction."""

GIVEN_UP = timedelta(minutes=10)
"""Silence after which whoever deletes or restores a map was killed."""


class Removals(Part):
    """See `worker.service.ports.Removals`.

    Parameters
    ----------
    database : Database
    images : ImageStore
    holding : function
        Snapshots that have images of some digests, also of those that were being made; see `SnapshotContents.holding`.
    answers_naming : function
        From ids of views to the stored answers that name them; see `Calls.answers_naming`.
    """

    def __init__(
        self,
        database: Database,
        images: ImageStore,
        holding: Callable[[Collection[str], Sequence[str]], tuple[Holding, ...]],
        answers_naming: Callable[[Collection[str]], StoredAnswers],
    ) -> None:
        super().__init__(database, images)
        self._holding, self._answers_naming = holding, answers_naming
        self._unfinished: set[int] = set()
        self._finishing: threading.Thread | None = None

    def delete_view(self, view_id: str, *, undoes: bool = False) -> Removal:
        """Remove a view completely; raises NotFound.

        `undoes`: an enrolment is taken back that nobody was told of, so that an import may bring its image; raises
        Conflict where a further call was told of the view, or may have been since it is described: it stays.
        """
        with self._database.reading() as connection:
            row = find_view(connection, view_id)
        gone = self._remove(row.map_id, [row.seq], self._answers_naming([row.id]), undoes=undoes)
        if gone.views == 0:  # deleted by another call meanwhile
            with self._database.reading() as connection:
                find_view(connection, view_id)
        return self._receipt([gone], gone.revision)

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that the filters select at the time of the call; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            fit = [VIEWS.c.map_id == row.id, *fitting(connection, filters, row.id)]
            ids = dict(connection.execute(sa.select(VIEWS.c.seq, VIEWS.c.id).where(*fit).order_by(VIEWS.c.seq)).all())
        seqs, answers = list(ids), self._answers_naming(ids.values())
        starts = range(0, len(seqs), PORTION)
        portions = [self._remove(row.id, seqs[start : start + PORTION], answers) for start in starts]
        return self._receipt(portions, portions[-1].revision if portions else row.revision)

    def delete_map(self, name: str) -> Removal:
        """Remove a map, its views and their images; raises NotFound."""

        taken: list[int] = []

        def take_name(connection: sa.Connection) -> tuple[int, list[str]]:
            map_id = int(find_map(connection, name).id)
            taken[:] = [map_id]
            # So that a later map of this name begins after every index of this one.
            clock.tick(connection, map_id)
            _take_name(connection, map_id)
            making = _being_made(connection, map_id)
            # A snapshot that is being made ends, unless it is written already and about to be kept.
            connection.execute(sa.delete(JOBS).where(JOBS.c.map_id == map_id))
            return map_id, making

        with self._finished_later(taken):  # whose end may be unknown
            nameless = self._database.freeing(take_name)
        return self.clear(*nameless)

    def finish_late(self) -> None:
        """Finish, in a thread of its own, deletions that broke off in this process, and those that a killed one left.

        Maps that a killed process had restored by half are removed too. Returns at once.
        """
        with suppress(DiskFull, StorageFailed), self._database.reading() as connection:
            given_up = MAPS.c.name.is_(None), MAPS.c.given_up_at <= clock.shared_time(connection)
            self._unfinished.update(connection.scalars(sa.select(MAPS.c.id).where(*given_up)))
        some = self._unfinished or self._images.left
        if some and (self._finishing is None or not self._finishing.is_alive()):
            self._finishing = threading.Thread(target=self._finish, name="revisit-removing", daemon=True)
            self._finishing.start()

    def _finish(self) -> None:
        for map_id in list(self._unfinished):
            try:
                with self._database.reading() as connection:
                    named = connection.scalar(sa.select(MAPS.c.name).where(MAPS.c.id == map_id)) is not None
                if named:  # it was never deleted
                    self._unfinished.discard(map_id)
                else:
                    self.clear(map_id)
            except (DiskFull, StorageFailed) as error:
                log.info("a deletion that broke off is finished later: %s", error.detail)
        with suppress(DiskFull, StorageFailed):  # they stay in `left`
            if self._images.left and self._images.problem() is None:
                self._images.discard(self._images.left)

    @contextmanager
    def _finished_later(self, map_ids: Collection[int]) -> Iterator[None]:
        try:
            yield
        except (DiskFull, StorageFailed):
            self._unfinished.update(map_ids)
            raise

    def clear_deleted_maps(self) -> None:
        """Finish deletions of maps that a crash interrupted."""
        with self._database.reading() as connection:
            left = list(connection.scalars(sa.select(MAPS.c.id).where(MAPS.c.name.is_(None))))
        for map_id in left:
            self.clear(map_id)

    def withdraw(self, map_id: int) -> None:
        """Remove a map whose restoration broke off, and that may have its name by now."""
        with self._finished_later([map_id]):
            self._database.freeing(lambda connection: _take_name(connection, map_id))
        self.clear(map_id)

    def clear(self, map_id: int, making: Sequence[str] = ()) -> Removal:
        """Remove a map without a name, by its number; `making`: its snapshots that were being made until now.

        What breaks off is finished later, see `finish_late`.
        """
        with self._finished_later([map_id]):
            removal = self._clear(map_id, making)
        self._unfinished.discard(map_id)
        return removal

    def _clear(self, map_id: int, making: Sequence[str]) -> Removal:
        portions = []
        queries = 0
        while portion_of := self._database.freeing(
            lambda connection: drop_oldest(connection, map_id, 0, PORTION, matched=None)
        ):
            queries += portion_of
        some = sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == map_id).order_by(VIEWS.c.seq).limit(PORTION)
        with self._database.reading() as connection:
            ids = list(connection.scalars(sa.select(VIEWS.c.id).where(VIEWS.c.map_id == map_id)))
        answers = self._answers_naming(ids)
        while self._database.freeing(lambda connection: _at_work(connection, map_id)):
            with self._database.reading() as connection:
                seqs = list(connection.scalars(some))
            if not seqs:
                break
            portions.append(self._remove(map_id, seqs, answers))
        empty = sa.delete(MAPS).where(MAPS.c.id == map_id, MAPS.c.name.is_(None))
        self._database.freeing(lambda connection: connection.execute(empty))
        return replace(self._receipt(portions, None, making), queries=queries)

    def _receipt(self, portions: Sequence["_Gone"], revision: int | None, making: Sequence[str] = ()) -> Removal:
        """Sum up what was deleted, portion by portion, and name the snapshots that still have some of it.

        Empties the journal of the database first, where deleted rows would still stand.
        """
        self._database.scrub()
        digests = [digest for portion in portions for digest in portion.digests]
        started = list(dict.fromkeys([*making, *(one for portion in portions for one in portion.being_made)]))
        shared = frozenset[str]().union(*(portion.images.needed for portion in portions))
        return Removal(
            views=sum(portion.views for portion in portions),
            images=sum(portion.images.removed for portion in portions),
            revision=revision,
            queries=sum(portion.queries for portion in portions),
            scores=sum(portion.scores for portion in portions),
            descriptions=sum(portion.descriptions for portion in portions),
            searched=sum(portion.searched for portion in portions),
            images_shared=len(shared),
            snapshots=self._holding(digests, started),
        )

    def _remove(self, map_id: int, seqs: Sequence[int], answers: StoredAnswers, *, undoes: bool = False) -> "_Gone":
        """Delete views of a map, what the stored `answers` say of them, then the images that no view needs."""

        def remove(connection: sa.Connection) -> _Gone:
            if undoes:
                _refuse_known(connection, seqs)
            which = VIEWS.c.seq.in_(seqs)
            columns = VIEWS.c.seq, VIEWS.c.id, VIEWS.c.sha256, VIEWS.c.sent_sha256
            rows = list(connection.execute(sa.select(*columns).where(which)))
            descriptions = searched = queries = scores = 0
            changed_over = None
            if rows:
                there = list(connection.execute(_DESCRIBED, {"seqs": seqs}))
                descriptions, searched = len(there), sum(one.recipe == one.searched_by for one in there)
                bury(connection, map_id, [row.seq for row in rows])
                # SQLite adds no reference to a table that is there.
                queries = connection.execute(sa.delete(KEPT_QUERIES).where(KEPT_QUERIES.c.seq.in_(seqs))).rowcount
                scores = connection.execute(sa.delete(DAY_SCORES).where(DAY_SCORES.c.seq.in_(seqs))).rowcount
                outdate(connection, map_id, seqs)
                connection.execute(sa.delete(VIEWS).where(which))
                answers.forget(connection, [row.id for row in rows])
                if not undoes:
                    known = {digest for row in rows for digest in (row.sha256, row.sent_sha256) if digest is not None}
                    deleted_images.note(connection, map_id, known)
                changed_over = switching.finish_if_done(connection, map_id, datetime.now(UTC))
                if (shadow := connection.scalar(sa.select(MAPS.c.shadow).where(MAPS.c.id == map_id))) is not None:
                    switching.drop_rows(connection, shadow, {row.id for row in rows})
            revision = connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.id == map_id)) or 0
            digests = [str(row.sha256) for row in rows]
            # One that is claimed after this transaction reads what this one leaves.
            making = _being_made(connection, map_id)
            counts = descriptions, searched, queries, scores
            return _Gone(len(rows), _NONE, int(revision), digests, *counts, making, changed_over is not None)

        gone = self._database.freeing(remove)
        images = self._images.discard(gone.digests)
        if gone.ended_switch:
            forgetting.remove_after_switch(self._database, self._images, map_id)
        self._database.tidy()
        return gone._replace(images=images)


class _Gone(NamedTuple):
    """What one transaction deleted; `images`: what became of the files after it."""

    views: int
    images: Discarded
    revision: int
    digests: list[str]
    descriptions: int
    searched: int
    queries: int
    scores: int
    being_made: list[str]
    ended_switch: bool


_NONE = Discarded(0, frozenset())

_DESCRIBED = (
    sa.select(DESCRIPTIONS.c.recipe, MAPS.c.recipe.label("searched_by"))
    .join(MAPS, MAPS.c.id == DESCRIPTIONS.c.map_id)
    .where(DESCRIPTIONS.c.seq.in_(sa.bindparam("seqs", expanding=True)))
)


def _refuse_known(connection: sa.Connection, seqs: Sequence[int]) -> None:
    """Raise Conflict where another call was told of one of these views, or may have been since searches find it."""
    if connection.scalar(sa.select(JOBS.c.id).where(JOBS.c.seq.in_(seqs), JOBS.c.told).limit(1)):
        raise Conflict("another call was told of this view")
    if connection.scalar(sa.select(VIEWS.c.id).where(VIEWS.c.seq.in_(seqs), VIEWS.c.state == "ready").limit(1)):
        raise Conflict("this view was described meanwhile")


def _take_name(connection: sa.Connection, map_id: int) -> None:
    """Take the name of a map away, so that no call finds it; its views are deleted next, or after a crash later on."""
    left = {"name": None, "given_up_at": clock.shared_time(connection) + GIVEN_UP}
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(**left))


def _at_work(connection: sa.Connection, map_id: int) -> bool:
    """Note that this process removes a map, so that no other does, and a restoration of it stops.

    Returns whether there is anything to remove: a map that has no name.
    """
    at = clock.shared_time(connection) + GIVEN_UP
    told = {"given_up_at": at, "checksum": MAPS.c.checksum}  # which does not cover the other
    nameless = MAPS.c.id == map_id, MAPS.c.name.is_(None)
    return connection.execute(sa.update(MAPS).where(*nameless).values(**told)).rowcount > 0


def _being_made(connection: sa.Connection, map_id: int) -> list[str]:
    """Ids of the snapshots of a map that are being made."""
    running = JOBS.c.map_id == map_id, JOBS.c.kind == "snapshot", JOBS.c.state == "running"
    return list(connection.scalars(sa.select(JOBS.c.id).where(*running)))
