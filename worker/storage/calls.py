"""Calls with an Idempotency-Key, and the answers to them."""

import json
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta

import sqlalchemy as sa

from schemas.errors import Conflict, Damaged, DiskFull, KeyReused, StorageFailed
from schemas.records import Replay
from worker.storage import checksums, clock, dialect
from worker.storage.answers import StoredAnswers, current, ids_in
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.rows import as_json
from worker.storage.tables import CALLS

KEPT = timedelta(hours=24)

GIVEN_UP = timedelta(minutes=10)
"""Time after which a call without an answer counts as killed with its process. If it still runs, an enrolment that is
sent again does no harm: two enrolments of an image are one."""

EXPIRED_EVERY_S = 3600.0
"""Seconds between looks for calls whose time is over, where no new one looks."""


class Calls(Part):
    """Calls by Idempotency-Key, kept for a day after they began.

    A call whose end was not stored would seem to run all that day, so ends that cannot be stored now are held in memory
    and stored later.
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
        own = key.partition(" ")[0]  # the caller's own key; what follows says whose it is

        def forget() -> None:
            self._delete(CALLS.c.key == key, CALLS.c.begun_at == now)

        with self._late_unless_done(key, forget), self._database.writing() as connection:
            now = _time(connection, now, shared)
            connection.execute(sa.delete(CALLS).where(CALLS.c.begun_at <= now - KEPT))
            # Only this key: to find others, all calls of a day would be read while nobody else may write.
            given_up = CALLS.c.key == key, CALLS.c.finished_at.is_(None), CALLS.c.begun_at <= now - GIVEN_UP
            connection.execute(sa.delete(CALLS).where(*given_up))
            row = connection.execute(sa.select(CALLS).where(CALLS.c.key == key)).one_or_none()
            if row is None:
                connection.execute(sa.insert(CALLS).values(key=key, fingerprint=fingerprint, begun_at=now))
                return None
        if row.fingerprint != fingerprint:
            raise KeyReused(f"the Idempotency-Key {own!r} came before with another request; take a new key")
        if row.finished_at is None:
            raise Conflict(f"the first call with the Idempotency-Key {own!r} still runs; try again when it has ended")
        if not checksums.is_whole(CALLS, row):
            raise Damaged(f"the stored answer to the call with the Idempotency-Key {own!r} is damaged; take a new key")
        return Replay(row.status, json.loads(row.headers), row.body)

    def end(self, key: str, replay: Replay, now: datetime) -> None:
        """Store the answer to a call, up to date with the views in it that were deleted or changed while it ran."""
        self._store(key, lambda: self._end(key, replay, now))

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
        self._database.stain()

    def answers_naming(self, views: Collection[str]) -> StoredAnswers:
        """The stored answers that name some views, given by their ids, which are about to be deleted."""
        return StoredAnswers(self._database, views)

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

    def _end(self, key: str, replay: Replay, now: datetime) -> None:
        body = bytes(replay.body)
        ids = ids_in(body)
        # In turn: a transaction that deletes or changes such a view comes after this one, and finds the answer, or was
        # committed before it.
        with self._database.writing(in_turn=bool(ids)) as connection:
            kept = {
                "status": int(replay.status),
                "headers": as_json(dict(replay.headers)),
                "body": current(connection, body, ids) if ids else body,
            }
            ended = sa.update(CALLS).where(CALLS.c.key == key, CALLS.c.finished_at.is_(None))
            connection.execute(ended.values(finished_at=now, **kept))

    def _delete(self, *which: sa.ColumnElement[bool]) -> None:
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(sa.delete(CALLS).where(*which, CALLS.c.finished_at.is_(None)))


def _time(connection: sa.Connection, now: datetime, shared: bool) -> datetime:
    """The time by the server's clock where that is wanted and there is a server; else `now`."""
    return now if not shared or dialect.is_file(connection.engine) else clock.shared_time(connection)
