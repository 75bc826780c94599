"""API keys: their hashes, and what each allows."""

import json
import logging
from datetime import datetime
from typing import Any

import sqlalchemy as sa

from schemas.errors import Conflict, NotFound
from schemas.keys import KeyRecord, Rates
from worker.storage import checksums
from worker.storage.columns import NEVER
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.tables import KEYS

log = logging.getLogger("revisit")


class Keys(Part):
    """See `worker.service.keys.KeyStore`."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._told: set[str] = set()  # damaged keys that the log has

    def all(self) -> list[KeyRecord]:
        """All keys, also those that are no longer in force, oldest first; a damaged one counts as revoked."""
        with self._database.reading() as connection:
            rows = list(connection.execute(sa.select(KEYS).order_by(KEYS.c.created_at, KEYS.c.id)))
        damaged = {row.id for row in rows if not checksums.is_whole(KEYS, row)}
        for key_id in damaged - self._told:  # once: the keys are read every second
            log.error("the key %s is damaged and lets nobody in; revoke it and make another", key_id)
        self._told |= damaged
        return [_record(row) for row in rows]

    def add(self, record: KeyRecord) -> None:
        """Keep a new key; raises Conflict when a key in force has its name."""
        with self._database.writing() as connection:
            same = sa.select(KEYS.c.id).where(KEYS.c.name == record.name, KEYS.c.revoked_at.is_(None))
            if connection.execute(same).first() is not None:
                raise Conflict(f"there is a key {record.name!r} already; revoke it first, or take another name")
            connection.execute(
                sa.insert(KEYS).values(
                    id=record.id,
                    name=record.name,
                    digest=bytes(record.digest),
                    scope=record.scope,
                    maps=None if record.maps is None else json.dumps(record.maps),
                    requests_per_minute=record.rates.requests,
                    images_per_minute=record.rates.images,
                    mb_per_minute=record.rates.mb,
                    created_at=record.created_at,
                    expires_at=record.expires_at,
                )
            )

    def revoke(self, name: str, now: datetime) -> KeyRecord:
        """End a key for ever; raises NotFound when no key in force has this name."""
        with self._database.writing() as connection:
            row = connection.execute(
                sa.select(KEYS).where(KEYS.c.name == name, KEYS.c.revoked_at.is_(None))
            ).one_or_none()
            if row is None:
                raise NotFound("key", name, "`./revisit keys list` shows all of them")
            connection.execute(sa.update(KEYS).where(KEYS.c.id == row.id).values(revoked_at=now))
            return _record(row)

    def remove(self, key_id: str | None = None) -> int:
        """Forget a key as if it had never been, or all of them; returns how many."""
        with self._database.writing() as connection:
            gone = sa.delete(KEYS) if key_id is None else sa.delete(KEYS).where(KEYS.c.id == key_id)
            return connection.execute(gone).rowcount

    def used(self, key_id: str, hour: datetime) -> None:
        """Note the hour in which a key was used last."""
        with self._database.writing(in_turn=False) as connection:
            connection.execute(sa.update(KEYS).where(KEYS.c.id == key_id).values(last_used_at=hour))


def _record(row: sa.Row[Any]) -> KeyRecord:
    if not checksums.is_whole(KEYS, row):
        return KeyRecord(
            id=str(row.id),
            name=str(row.name),
            digest=b"",
            scope="read",
            maps=(),
            rates=Rates(),
            created_at=NEVER,
            revoked_at=NEVER,
        )
    return KeyRecord(
        id=row.id,
        name=row.name,
        digest=bytes(row.digest),
        scope=row.scope,
        maps=None if row.maps is None else tuple(json.loads(row.maps)),
        rates=Rates(row.requests_per_minute, row.images_per_minute, row.mb_per_minute),
        created_at=row.created_at,
        expires_at=row.expires_at,
        revoked_at=row.revoked_at,
        last_used_at=row.last_used_at,
    )
