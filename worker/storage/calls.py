"""Calls with an Idempotency-Key, and vocabularies."""

import hashlib
import json
from datetime import datetime, timedelta

import sqlalchemy as sa

from schemas.errors import Conflict, Damaged, KeyReused, NotFound
from schemas.records import Replay
from worker.storage import checksums
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.rows import as_json
from worker.storage.tables import CALLS, VOCABULARIES

KEPT = timedelta(hours=24)

GIVEN_UP = timedelta(minutes=10)
"""Time after which a call without an answer no longer runs: its process was killed, or could not tell that it failed.
Enrolling the same image twice makes one view."""


class Calls(Part):
    """Calls by Idempotency-Key, kept for a day after they began."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._failed: set[str] = set()  # of this process, which could not delete them

    def begin(self, key: str, fingerprint: str, now: datetime) -> Replay | None:
        """Claim an Idempotency-Key; returns the stored answer when the call has finished, None when it is new.

        Raises
        ------
        KeyReused
            The key was used with another request.
        Conflict
            The first call with the key still runs.
        """
        with self._database.writing() as connection:
            given_up = CALLS.c.finished_at.is_(None) & (CALLS.c.begun_at <= now - GIVEN_UP)
            if key in self._failed:
                given_up |= CALLS.c.finished_at.is_(None) & (CALLS.c.key == key)
            connection.execute(sa.delete(CALLS).where((CALLS.c.begun_at <= now - KEPT) | given_up))
            row = connection.execute(sa.select(CALLS).where(CALLS.c.key == key)).one_or_none()
            if row is None:
                connection.execute(sa.insert(CALLS).values(key=key, fingerprint=fingerprint, begun_at=now))
        self._failed.discard(key)
        if row is None:
            return None
        if row.fingerprint != fingerprint:
            raise KeyReused(f"the Idempotency-Key {key!r} came before with another request; take a new key")
        if row.finished_at is None:
            raise Conflict(f"the first call with the Idempotency-Key {key!r} still runs; try again when it has ended")
        if not checksums.is_whole(CALLS, row, row.checksum):
            raise Damaged(f"the stored answer to the call with the Idempotency-Key {key!r} is damaged; take a new key")
        return Replay(row.status, json.loads(row.headers), row.body)

    def end(self, key: str, replay: Replay, now: datetime) -> None:
        """Store the answer to a call."""
        with self._database.writing(in_turn=False) as connection:
            connection.execute(
                sa.update(CALLS)
                .where(CALLS.c.key == key)
                .values(
                    finished_at=now,
                    status=int(replay.status),
                    headers=as_json(dict(replay.headers)),
                    body=bytes(replay.body),
                )
            )

    def abandon(self, key: str) -> None:
        """Delete an unfinished call that failed, so that it can be tried again, at once where that is not possible."""
        self._failed.add(key)
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(sa.delete(CALLS).where(CALLS.c.key == key, CALLS.c.finished_at.is_(None)))
        self._failed.discard(key)


class Vocabularies(Part):
    """Trained vocabularies by digest."""

    def keep(self, digest: str, tensors: bytes) -> None:
        """Store safetensors bytes under their SHA-256; a second time does nothing."""
        with self._database.writing() as connection:
            if connection.scalar(sa.select(VOCABULARIES.c.digest).where(VOCABULARIES.c.digest == digest)) is None:
                connection.execute(sa.insert(VOCABULARIES).values(digest=digest, tensors=bytes(tensors)))

    def get(self, digest: str) -> bytes:
        """The safetensors bytes of a vocabulary; raises NotFound."""
        with self._database.reading() as connection:
            tensors = connection.scalar(sa.select(VOCABULARIES.c.tensors).where(VOCABULARIES.c.digest == digest))
        if tensors is None:
            raise NotFound("vocabulary", digest)
        if hashlib.sha256(tensors).hexdigest() != digest:
            raise Damaged(f"the stored vocabulary {digest} is damaged; train the map another one, or restore a backup")
        return bytes(tensors)
