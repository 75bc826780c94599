"""Calls with an Idempotency-Key, and vocabularies."""

import hashlib
import json
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime, timedelta
from functools import partial
from typing import Any

import sqlalchemy as sa

from schemas.errors import Conflict, Damaged, DiskFull, KeyReused, NotFound, StorageFailed
from schemas.records import Replay, ViewAttributes
from schemas.wire_views import rfc3339
from worker.storage import checksums, clock, dialect
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.rows import as_json, batches
from worker.storage.tables import CALLS, VOCABULARIES

KEPT = timedelta(hours=24)

GIVEN_UP = timedelta(minutes=10)
"""After which a call without an answer no longer runs: its process was killed. Two enrolments of an image are one."""

EXPIRED_EVERY_S = 3600.0
"""Seconds between looks for calls whose time is over, where no new one looks."""

FEW = 8
"""Deleted views up to which the database looks for their ids; for more all answers are read once."""

DELETED: Mapping[str, Any] = {
    "place": None, "position": None, "captured_at": None, "metadata": {}, "filename": None, "description": None,
}  # fmt: skip
"""What a view that was deleted has in an answer that is repeated."""

SINCE_DELETED = "it concerned a view that was deleted since"

SINCE_CHANGED = "it concerned a view whose attributes were changed since"

Retelling = Callable[[dict[str, Any]], None]
"""Changes what an answer tells of a view, in place."""

_ID = re.compile("[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")


class Calls(Part):
    """Calls by Idempotency-Key, kept for a day after they began.

    A call whose end cannot be stored would seem to run for that day: such ends are held and stored later.
    """

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._late: dict[str, Callable[[], None]] = {}
        self._expires_at = time.monotonic() + EXPIRED_EVERY_S

    def begin(self, key: str, fingerprint: str, now: datetime, *, shared: bool = False) -> Replay | None:
        """Claim an Idempotency-Key; returns the stored answer when the call has finished, None when it is new.

        Parameters
        ----------
        key, fingerprint : str
        now : datetime
        shared : bool
            Go by the clock of the database's server instead, if it has one: the services of a fleet differ in theirs.

        Raises
        ------
        KeyReused
            The key was used with another request.
        Conflict
            The first call with the key still runs.
        """
        if key in self._late:
            self.finish_late()
        own = key.partition(" ")[0]  # behind it stands whose it is

        def forget() -> None:
            self._delete(CALLS.c.key == key, CALLS.c.begun_at == now)

        with self._late_unless_done(key, forget), self._database.writing() as connection:
            now = _time(connection, now, shared)
            given_up = CALLS.c.finished_at.is_(None) & (CALLS.c.begun_at <= now - GIVEN_UP)
            connection.execute(sa.delete(CALLS).where((CALLS.c.begun_at <= now - KEPT) | given_up))
            row = connection.execute(sa.select(CALLS).where(CALLS.c.key == key)).one_or_none()
            if row is None:
                connection.execute(sa.insert(CALLS).values(key=key, fingerprint=fingerprint, begun_at=now))
                return None
        if row.fingerprint != fingerprint:
            raise KeyReused(f"the Idempotency-Key {own!r} came before with another request; take a new key")
        if row.finished_at is None:
            raise Conflict(f"the first call with the Idempotency-Key {own!r} still runs; try again when it has ended")
        if not checksums.is_whole(CALLS, row, row.checksum):
            raise Damaged(f"the stored answer to the call with the Idempotency-Key {own!r} is damaged; take a new key")
        return Replay(row.status, json.loads(row.headers), row.body)

    def end(self, key: str, replay: Replay, now: datetime) -> None:
        """Store the answer to a call."""
        kept = {
            "status": int(replay.status), "headers": as_json(dict(replay.headers)), "body": bytes(replay.body),
        }  # fmt: skip
        ended = sa.update(CALLS).where(CALLS.c.key == key, CALLS.c.finished_at.is_(None))
        self._store(key, lambda: self._end(ended.values(finished_at=now, **kept)))

    def abandon(self, key: str) -> None:
        """Delete an unfinished call that failed, so that it can be tried again."""
        self._store(key, lambda: self._delete(CALLS.c.key == key))

    def finish_late(self) -> None:
        """Store the ends of calls that could not be stored; raises DiskFull, StorageFailed as long as they cannot."""
        for key, store in list(self._late.items()):
            store()
            self._late.pop(key, None)

    def expire(self, now: datetime, *, shared: bool = False) -> None:
        """Delete calls whose time is over, by the clock of `begin`, now and then; raises DiskFull, StorageFailed."""
        if time.monotonic() < self._expires_at:
            return
        self._expires_at = time.monotonic() + EXPIRED_EVERY_S
        with self._database.reading() as connection:
            over = CALLS.c.begun_at <= _time(connection, now, shared) - KEPT
            if connection.execute(sa.select(CALLS.c.key).where(over).limit(1)).first() is None:
                return
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(sa.delete(CALLS).where(over))

    def forget_views(self, views: Collection[str]) -> None:
        """Leave of deleted views nothing but their ids in the answers that are kept to be repeated.

        All of a day are looked through: the clocks of a fleet do not tell which ended before a view was enrolled.

        Parameters
        ----------
        views : collection of str
            Their ids.

        Raises
        ------
        DiskFull, StorageFailed
        """
        kept = sa.select(CALLS.c.key, CALLS.c.body).where(CALLS.c.finished_at.is_not(None))
        if len(views) <= FEW:
            kept = kept.where(sa.or_(*(_named(self._database.engine, view) for view in views)))
        with self._database.reading() as connection:
            rows = connection.execution_options(yield_per=100).execute(kept)
            keys = [row.key for row in rows if _names(row.body or b"", views)]
        for portion in batches(keys):
            self._database.freeing(partial(_retell, keys=portion, ids=views, change=_forget, why=SINCE_DELETED))

    def _store(self, key: str, store: Callable[[], None]) -> None:
        """Store the end of a call now, or later where that cannot be done."""
        with self._late_unless_done(key, store):
            store()

    @contextmanager
    def _late_unless_done(self, key: str, store: Callable[[], None]) -> Iterator[None]:
        """Remember `store` for later where the block cannot be stored."""
        try:
            yield
        except (DiskFull, StorageFailed):
            self._late[key] = store
            raise
        self._late.pop(key, None)

    def _end(self, ended: sa.Update) -> None:
        with self._database.writing(in_turn=False) as connection:
            connection.execute(ended)

    def _delete(self, *which: sa.ColumnElement[bool]) -> None:
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(sa.delete(CALLS).where(*which, CALLS.c.finished_at.is_(None)))


def _time(connection: sa.Connection, now: datetime, shared: bool) -> datetime:
    """The time by the server's clock where that is wanted and there is a server; else `now`."""
    return now if not shared or dialect.is_file(connection.engine) else clock.shared_time(connection)


def tell_changed(connection: sa.Connection, view_id: str, attributes: ViewAttributes) -> None:
    """Have the answers that are kept to be repeated tell of a view what it has now, and nothing that it had."""
    kept = sa.select(CALLS.c.key).where(CALLS.c.finished_at.is_not(None), _named(connection.engine, view_id))
    position = asdict(attributes.position)
    now = {
        "place": attributes.place,
        "position": None if all(value is None for value in position.values()) else position,
        "captured_at": None if attributes.captured_at is None else rfc3339(attributes.captured_at),
        "metadata": dict(attributes.metadata),
        "filename": attributes.filename,
    }
    keys = connection.scalars(kept).all()
    _retell(connection, keys, [view_id], lambda view: view.update(now), SINCE_CHANGED)


def _named(engine: sa.Engine, view_id: str) -> sa.ColumnElement[bool]:
    """SQL condition that the id of a view stands in an answer."""
    wanted = sa.literal(view_id.encode(), sa.LargeBinary)
    if dialect.is_file(engine):
        return sa.func.instr(CALLS.c.body, wanted) > 0
    return sa.func.position(wanted.op("IN")(CALLS.c.body)) > 0


def _names(text: bytes, ids: Collection[str]) -> bool:
    """Whether some text has the id of one of these views."""
    return any(found in ids for found in _ID.findall(text.decode(errors="replace")))


def _retell(
    connection: sa.Connection, keys: Collection[str], ids: Collection[str], change: Retelling, why: str
) -> None:
    """Change what the answers of some calls tell of some views; one that is damaged goes as a whole."""
    for row in list(connection.execute(sa.select(CALLS).where(CALLS.c.key.in_(keys)))):
        of = CALLS.c.key == row.key
        if row.finished_at is None or not checksums.is_whole(CALLS, row, row.checksum):
            connection.execute(sa.delete(CALLS).where(of, CALLS.c.finished_at.is_not(None)))
        else:
            connection.execute(sa.update(CALLS).where(of).values(body=_retold(row.body, ids, change, why)))


def _retold(body: bytes, ids: Collection[str], change: Retelling, why: str) -> bytes:
    """The answer to an enrolment, of one image or of several, with what it tells of some views changed."""
    answer = json.loads(body)
    for one in (answer, *answer.get("views", ())):
        view = one.get("view")
        if isinstance(view, dict) and view["id"] in ids:
            change(view)
        for warning in one.get("warnings", ()):
            if warning["view"] in ids:
                warning["detail"] = why
    for refused in (answer, *answer.get("errors", ())):
        if _names(refused.get("detail", "").encode(), ids):
            refused["detail"] = why
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()


def _forget(view: dict[str, Any]) -> None:
    """Leave of a deleted view nothing but its id, and what its image is like."""
    view |= DELETED
    view["image"]["sha256"] = "0" * 64


def keep_vocabulary(connection: sa.Connection, digest: str, tensors: bytes) -> None:
    """Store safetensors bytes under their SHA-256; a second time does nothing."""
    if connection.scalar(sa.select(VOCABULARIES.c.digest).where(VOCABULARIES.c.digest == digest)) is None:
        connection.execute(sa.insert(VOCABULARIES).values(digest=digest, tensors=bytes(tensors)))


class Vocabularies(Part):
    """Trained vocabularies by digest."""

    def keep(self, digest: str, tensors: bytes) -> None:
        """As `keep_vocabulary`, for tests and studies: without a recipe that names it, it is pruned soon."""
        with self._database.writing() as connection:
            keep_vocabulary(connection, digest, tensors)

    def get(self, digest: str) -> bytes:
        """The safetensors bytes of a vocabulary; raises NotFound."""
        with self._database.reading() as connection:
            tensors = connection.scalar(sa.select(VOCABULARIES.c.tensors).where(VOCABULARIES.c.digest == digest))
        if tensors is None:
            raise NotFound("vocabulary", digest)
        if hashlib.sha256(tensors).hexdigest() != digest:
            raise Damaged(f"the stored vocabulary {digest} is damaged; train the map another one, or restore a backup")
        return bytes(tensors)
