"""Restoring a snapshot: all of it is verified first, then it is stored under no name, and named last.

A map without a name is found by no call, and is removed when the service starts, or by another one ten minutes after
the last sign of who restored it: whatever ends a restoration half way, nothing of it is ever seen.

Its views have the times between them that they had, up to the view that this service enrolled last, and no time passes
by them: views of other maps are as old as before.
"""

import hashlib
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import sqlalchemy as sa

from schemas.errors import BadSnapshot, Conflict, StorageFailed
from schemas.snapshot import RestoredMap, SnapshotFacts, SnapshotView
from worker.storage import checksums, clock, switching
from worker.storage.database import Database
from worker.storage.disk_errors import translated
from worker.storage.enrolment import fact_columns, keep_pairs
from worker.storage.enrolment_order import following_id, present
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.removals import GIVEN_UP, Removals
from worker.storage.rows import as_json, attribute_columns, batches, inserting, keep_recipe, log
from worker.storage.snapshot_files import (
    COMPARISONS as COMPARISON_PARTS,
    FACTS,
    IMAGE,
    VIEWS as VIEW_PARTS,
    VOCABULARY,
    SnapshotReader,
)
from worker.storage.snapshot_rows import attributes, description_rows, image_facts, read_comparisons, read_views
from worker.storage.tables import COMPARISONS, MAPS, VIEWS
from worker.storage.vocabularies import keep_vocabulary

TAKEN = "the map {!r} exists already; restore under another name (`as`), or delete that map first"

MOST_IMAGES, MOST_BYTES = 256, 32 * 1024 * 1024
"""Images that are written together: so many, or as many as have so many bytes."""


class Restoring(Part, retried=False):
    """Makes maps from snapshots.

    Parameters
    ----------
    database : Database
    images : ImageStore
    removals : Removals
        Removes what was stored of a restoration that failed.
    """

    def __init__(self, database: Database, images: ImageStore, removals: Removals) -> None:
        super().__init__(database, images)
        self._removals = removals

    def restore(
        self, path: Path, name: str | None, now: datetime, allow: Callable[[str], None] = lambda name: None
    ) -> RestoredMap:
        """Make a map from a snapshot; views keep their ids unless this service has one of them already.

        Parameters
        ----------
        path : Path
            File of the snapshot.
        name : str or None
            Of the new map; None for the name that the map had.
        now : datetime
        allow : function
            Raises when the caller may not make a map of this name.

        Raises
        ------
        BadSnapshot
            The file is not a whole snapshot; nothing was changed.
        Conflict
            There is a map of this name; nothing was changed.
        DiskFull
        """
        reader = SnapshotReader(path)
        with translated("snapshots"):
            facts = reader.facts()
            name = facts.map if name is None else name
            allow(name)
            with self._database.reading() as connection:
                _refuse_taken(connection, name)
            if self._database.space is not None:  # rows are written to the journal first, then to the database
                self._database.space.admit(path.stat().st_size + facts.row_bytes)
            restoration = _Restoration(self._database, self._images, facts, self._verify(reader, facts))
            try:
                restoration.store(reader)
                return restoration.finish(name, now)
            except BaseException as error:
                self._undo(restoration)
                if isinstance(error, sa.exc.IntegrityError):
                    raise Conflict(
                        "an image of the snapshot was enrolled with the same id while it was restored; nothing was "
                        "changed, try again"
                    ) from error
                raise

    def _verify(self, reader: SnapshotReader, facts: SnapshotFacts) -> "_Verified":
        """Compare the whole file with its manifest and its rows with each other."""
        taken, elapsed_us = False, 0
        images: set[bytes] = set()
        ids: set[str] = set()
        numbers = [-1]
        views = 0
        vocabulary = None
        for part in reader.verified():
            if part.name.startswith(IMAGE):
                digest = bytes.fromhex(part.name.removeprefix(IMAGE))
                if digest in images:
                    raise BadSnapshot(f"it has {part.name} twice")
                images.add(digest)
            elif part.name == VOCABULARY:
                vocabulary = hashlib.sha256(part.body).hexdigest()
            elif part.name.startswith(VIEW_PARTS):
                found = read_views(part, facts)
                taken = taken or self._are_taken([view.id for view in found])
                for view in found:
                    _check_view(view, numbers, images, ids, facts.keep_images)
                    elapsed_us = view.elapsed_us
                views += len(found)
            elif part.name.startswith(COMPARISON_PARTS):
                read_comparisons(part.name, part.body)
        if images:
            raise BadSnapshot(f"it has {len(images)} images without a view")
        if views != facts.views:
            raise BadSnapshot(f"it has {views} views; its {FACTS} says {facts.views}")
        if vocabulary not in (None, facts.description.vocabulary):
            raise BadSnapshot("its vocabulary is not the one of its recipe")
        return _Verified(taken, elapsed_us)

    def _are_taken(self, ids: list[str]) -> bool:
        with self._database.reading() as connection:
            return any(
                connection.scalar(sa.select(VIEWS.c.seq).where(VIEWS.c.id.in_(portion)).limit(1)) is not None
                for portion in batches(ids)
            )

    def _undo(self, restoration: "_Restoration") -> None:
        if restoration.map_id is None:
            return
        try:
            self._removals.withdraw(restoration.map_id)
        except Exception:
            log.exception("what was restored so far is removed later, or at the next start")


class _Verified(NamedTuple):
    """Of a whole snapshot: whether this service has one of its ids, and the elapsed time of its last view."""

    taken: bool
    elapsed_us: int


def _check_view(view: SnapshotView, numbers: list[int], images: set[bytes], ids: set[str], keep_images: bool) -> None:
    if view.number <= numbers[-1] or view.id in ids:
        raise BadSnapshot(f"the view {view.id} is there twice, or out of order")
    numbers[-1] = view.number
    ids.add(view.id)
    if not keep_images and view.state == "ready":
        return
    try:
        images.remove(bytes.fromhex(view.sha256))
    except KeyError:
        raise BadSnapshot(f"the image of the view {view.id} is missing, or another view has it") from None


def _refuse_taken(connection: sa.Connection, name: str) -> None:
    if connection.scalar(sa.select(MAPS.c.id).where(MAPS.c.name == name)) is not None:
        raise Conflict(TAKEN.format(name))


def _given_up_at(connection: sa.Connection) -> datetime:
    return clock.shared_time(connection) + GIVEN_UP


def _key_of(inserted: sa.CursorResult[Any]) -> int:
    """The key that the database gave a row."""
    assert inserted.inserted_primary_key is not None
    return int(inserted.inserted_primary_key[0])


class _Restoration:
    """One map while it is being stored, in portions, so that other writers do not wait for all of it."""

    def __init__(self, database: Database, images: ImageStore, facts: SnapshotFacts, verified: _Verified) -> None:
        self._database, self._images, self._facts = database, images, facts
        self._recipe = facts.description
        self.new_ids = verified.taken
        self.map_id: int | None = None
        self._given_up_at: datetime | None = None
        self._revision = 0
        self._seqs: dict[int, int] = {}
        self._pending: list[int] = []
        self._undescribed: set[int] = set()
        self._ended_us, self._shift_us = verified.elapsed_us, 0
        self._last_id: str | None = None

    def store(self, reader: SnapshotReader) -> None:
        """Store everything, under no name."""
        tensors = next((part.body for part in reader.parts(VOCABULARY)), None)
        self._make_map(tensors)
        for part in reader.parts(VIEW_PARTS):
            views = read_views(part, self._facts)
            with self._database.writing() as connection:
                self._sign(connection)
                self._store_views(connection, views)
        # The rows are there: from here on nobody begins to remove an image that another map gives up.
        self._images.await_removals()
        batch: dict[str, bytes] = {}
        for part in reader.parts(IMAGE):
            batch[part.name.removeprefix(IMAGE)] = part.body
            if len(batch) >= MOST_IMAGES or sum(map(len, batch.values())) >= MOST_BYTES:
                self._images.add(batch)
                batch.clear()
                with self._database.writing() as connection:
                    self._sign(connection)
        self._images.add(batch)
        for part in reader.parts(COMPARISON_PARTS):
            self._store_comparisons(part.name, part.body)

    def finish(self, name: str, now: datetime) -> RestoredMap:
        """Give the map its name, and queue the views that are not described."""
        assert self.map_id is not None
        with self._database.writing() as connection:
            _refuse_taken(connection, name)
            self._sign(connection, name=name, given_up_at=None)
            revision = clock.tick(connection, self.map_id)
            switching.queue(connection, self.map_id, self._pending, self._recipe.id, now, background=False)
        return RestoredMap(
            map=name,
            snapshot=self._facts.id,
            views=len(self._seqs),
            pending=len(self._pending),
            revision=revision,
            new_ids=self.new_ids,
        )

    def _sign(self, connection: sa.Connection, **changed: object) -> None:
        """Sign that this process is at work: put off the time from which the map counts as given up.

        Raises StorageFailed when that is no longer the time that this object stored: another process found the map
        given up, and removes it.
        """
        given_up_at = _given_up_at(connection)
        mine = MAPS.c.id == self.map_id, MAPS.c.given_up_at == self._given_up_at
        values = {"given_up_at": given_up_at, **changed}
        if connection.execute(sa.update(MAPS).where(*mine).values(**values)).rowcount == 0:
            raise StorageFailed("what was restored so far was removed, since nothing was added for minutes; try again")
        self._given_up_at = given_up_at

    def _make_map(self, tensors: bytes | None) -> None:
        facts = self._facts
        with self._database.writing() as connection:
            self._given_up_at = _given_up_at(connection)
            if tensors is not None:
                keep_vocabulary(connection, str(self._recipe.vocabulary), tensors)
            born = clock.read(connection)
            columns = {
                "recipe": keep_recipe(connection, self._recipe),
                "ranking": facts.ranking.model_dump_json(),
                "calibration": facts.calibration,
                "drop_images": None if facts.keep_images else True,
                "keep_queries": facts.keep_queries or None,
                "keep_matches": facts.keep_matches or None,
                "refuse_poor": facts.refuse_poor or None,
                "blur": as_json(list(facts.blur)) if facts.blur else None,
                "created_at": facts.map_created_at,
                "given_up_at": self._given_up_at,
            }
            made = connection.execute(sa.insert(MAPS).values(name=None, revision=born, anew=born, **columns))
            map_id = _key_of(made)
            self._revision = clock.tick(connection, map_id)
            connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(anew=self._revision))
            self._last_id = connection.scalar(sa.select(VIEWS.c.id).order_by(VIEWS.c.seq.desc()).limit(1))
            enrolled_us = present(connection)
        self.map_id = map_id
        # A microsecond before the view enrolled last, by which that is known: see enrolment_order.py.
        self._shift_us = (0 if enrolled_us is None else enrolled_us - 1) - self._ended_us

    def _store_views(self, connection: sa.Connection, views: list[SnapshotView]) -> None:
        rows: dict[sa.Table, list[dict[str, Any]]] = {}
        for view in views:
            for table, row in self._store_view(connection, view).items():
                rows.setdefault(table, []).append(row)
        for table, together in rows.items():
            connection.execute(inserting(table), together)

    def _store_view(self, connection: sa.Connection, view: SnapshotView) -> dict[sa.Table, dict[str, Any]]:
        """Store a view; returns the rows of its description."""
        assert self.map_id is not None
        said = attributes(view)
        view_id = view.id
        if self.new_ids:
            view_id = self._last_id = following_id(self._last_id)
        columns = {
            "id": view_id,
            "map_id": self.map_id,
            "enrolled_at": view.enrolled_at,
            "elapsed_us": min(view.elapsed_us, self._ended_us) + self._shift_us,
            **fact_columns(image_facts(view)),
            "sent_sha256": view.sent_sha256,
            **attribute_columns(said),
        }
        state = {"state": view.state, "failure_code": view.failure_code, "failure_detail": view.failure_detail}
        sealed = {**columns, **state, "checksum": checksums.of_row(VIEWS, columns)}
        seq = _key_of(connection.execute(inserting(VIEWS), sealed))
        self._seqs[view.number] = seq
        if said.metadata:
            keep_pairs(connection, seq, said)
        rows = description_rows(view, seq, self.map_id, self._recipe.id, self._revision)
        if not rows:
            self._undescribed.add(view.number)
        if view.state == "pending":
            self._pending.append(seq)
        return rows

    def _store_comparisons(self, name: str, body: bytes) -> None:
        rows = [
            {
                "seq": self._seqs[one.number],
                "recipe": self._recipe.id,
                "map_id": self.map_id,
                "among": one.among,
                "others": one.others,
                "level": one.level,
                "gap": one.gap,
                "same_spot": as_json([self._seqs[number] for number in one.same_spot if number in self._seqs]),
                "made_at": one.made_at,
                "rival": None if one.rival is None else self._seqs.get(one.rival),
                "own": one.own,
                "breadth": one.breadth,
            }
            for one in read_comparisons(name, body)
            if one.number in self._seqs and one.number not in self._undescribed
        ]
        if rows:
            with self._database.writing() as connection:
                self._sign(connection)
                connection.execute(inserting(COMPARISONS), rows)
