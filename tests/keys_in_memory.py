"""Keys without a database."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

from schemas.errors import Conflict, NotFound
from schemas.keys import KeyRecord, Rates, Scope
from worker.service.keys import KeyService

NOW = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)


class KeysInMemory:
    """Keeps the promises of `worker.service.keys.KeyStore`."""

    def __init__(self) -> None:
        self.kept: dict[str, KeyRecord] = {}
        self.reads = 0
        self.fails: Exception | None = None

    def all(self) -> list[KeyRecord]:
        self.reads += 1
        if self.fails is not None:
            raise self.fails
        return list(self.kept.values())

    def add(self, record: KeyRecord) -> None:
        if any(one.name == record.name and one.revoked_at is None for one in self.kept.values()):
            raise Conflict(f"there is a key {record.name!r} already")
        self.kept[record.id] = record

    def revoke(self, name: str, now: datetime) -> KeyRecord:
        for record in self.kept.values():
            if record.name == name and record.revoked_at is None:
                self.kept[record.id] = replace(record, revoked_at=now)
                return record
        raise NotFound("key", name)

    def remove(self, key_id: str | None = None) -> int:
        gone = [one for one in self.kept if key_id in (None, one)]
        for one in gone:
            del self.kept[one]
        return len(gone)

    def used(self, key_id: str, hour: datetime) -> None:
        self.kept[key_id] = replace(self.kept[key_id], last_used_at=hour)


class KeyMaker:
    """A key service of its own, and keys of every kind by name."""

    def __init__(self) -> None:
        self.store = KeysInMemory()
        self.seconds = 0.0
        self.service = KeyService(self.store, lambda: self.seconds)

    def make(self, name: str, scope: Scope, *maps: str, rates: Rates = Rates()) -> str:  # noqa: B008 (frozen)
        return self.service.create(name, scope, datetime.now(UTC), maps=maps or None, rates=rates)[1]

    def expired(self, name: str = "expired") -> str:
        long_ago = datetime.now(UTC) - timedelta(days=2)
        return self.service.create(name, "admin", long_ago, expires_at=long_ago + timedelta(days=1))[1]

    def revoked(self, name: str = "revoked") -> str:
        key = self.make(name, "admin")
        self.service.revoke(name, datetime.now(UTC))
        return key
