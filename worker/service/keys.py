"""API keys: made, listed, revoked, and recognised when a caller sends one.

A key is ``rv_<id>_<secret><checksum>``: 12 hexadecimal digits, 43 letters and digits drawn at random (256 bits), and
the CRC-32 of all before it in 6 letters and digits, by which scanners for secrets tell a key from other text.

Only its SHA-256 is kept. A slow hash protects what people can guess; nobody guesses 256 random bits, however fast the
hash is, so that a slow one would protect nothing and make each request slow.
"""

import hashlib
import hmac
import re
import secrets
import string
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Protocol

from schemas.errors import InvalidParameters, Unauthorized
from schemas.keys import UNRESTRICTED, Access, KeyRecord, Rates, Scope

FRESH_S = 0.5
"""Seconds for which what was read of the keys is good: within them a revoked key is still taken."""

FIRST = "first"
"""Name of the key that the first start in a container makes."""

LONGEST = timedelta(days=36_500)

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_KEY = re.compile(r"rv_([0-9a-f]{12})_[0-9A-Za-z]{49}")
_ALPHABET = string.digits + string.ascii_uppercase + string.ascii_lowercase
_SECRET_LENGTH, _CHECK_LENGTH = 43, 6
_NO_DIGEST = bytes(32)


class KeyStore(Protocol):
    """Where keys are kept; `worker.storage.keys.Keys` is one."""

    def all(self) -> list[KeyRecord]:
        """All keys, also those that are no longer in force, oldest first."""
        ...

    def add(self, record: KeyRecord) -> None:
        """Keep a new key; raises Conflict when a key in force has its name."""
        ...

    def revoke(self, name: str, now: datetime) -> KeyRecord:
        """End a key for ever; raises NotFound when no key in force has this name."""
        ...

    def remove(self, key_id: str | None = None) -> int:
        """Forget a key as if it had never been, or all of them; returns how many."""
        ...

    def used(self, key_id: str, hour: datetime) -> None:
        """Note the hour in which a key was used last."""
        ...


@dataclass(frozen=True)
class KeyRing:
    """The keys as they were read at one moment.

    Parameters
    ----------
    keys : mapping of id to KeyRecord
        Also those that are no longer in force: revoking the last key does not open the service.
    read_at : float
        Seconds of the monotonic clock.
    """

    keys: Mapping[str, KeyRecord]
    read_at: float

    @property
    def closed(self) -> bool:
        """Whether callers need a key."""
        return bool(self.keys)

    def access(self, text: str | None, now: datetime) -> Access:
        """What the holder of a key may do; without keys, everybody may do everything.

        Raises
        ------
        Unauthorized
            No key, none of these, or one that is no longer in force. Its text never repeats what was sent.
        """
        if not self.closed:
            return UNRESTRICTED
        if text is None:
            raise Unauthorized("this service needs a key: send `Authorization: Bearer KEY`, or `X-Api-Key: KEY`")
        form = _KEY.fullmatch(text)
        record = self.keys.get(form[1]) if form else None
        # An unknown id takes the same path, so that the time tells nothing of which ids there are.
        expected = _NO_DIGEST if record is None else record.digest
        if not hmac.compare_digest(_digest(text), expected) or record is None:
            raise Unauthorized("the key is not one of this service; `./revisit keys list` shows those there are")
        state = record.state(now)
        if state != "valid":
            raise Unauthorized(f"the key {record.name!r} is {state}; `./revisit keys create` makes another one")
        return record.access


class KeyService:
    """The use-cases around keys.

    Parameters
    ----------
    keys : KeyStore
    monotonic : function
        Seconds of a clock that never goes back.
    """

    def __init__(self, keys: KeyStore, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._keys, self._monotonic = keys, monotonic
        self._ring: KeyRing | None = None
        self._noted: dict[str, datetime] = {}

    def create(
        self,
        name: str,
        scope: Scope,
        now: datetime,
        *,
        maps: Sequence[str] | None = None,
        expires_at: datetime | None = None,
        rates: Rates = Rates(),  # noqa: B008 (frozen)
    ) -> tuple[KeyRecord, str]:
        """Make a key; returns its record and the key itself, which is told nowhere else.

        Parameters
        ----------
        name : str
            The operator's own, as map names are written.
        scope : Scope
        now : datetime
        maps : sequence of str or None
            The maps it may use; they need not exist yet. None: all.
        expires_at : datetime or None
            None: never.
        rates : Rates
            Limits of its own.

        Raises
        ------
        InvalidParameters, Conflict
        """
        for parameter, value in (("name", name), *(("map", one) for one in maps or ())):
            if not _NAME.fullmatch(value):
                raise InvalidParameters.of(parameter, f"{value[:80]!r} needs to match {_NAME.pattern}")
        if expires_at is not None and not now < expires_at <= now + LONGEST:
            raise InvalidParameters.of("expires", f"{expires_at.isoformat()} is past, or more than 100 years ahead")
        key_id, key = new_key()
        kept = None if maps is None else tuple(sorted(set(maps)))
        record = KeyRecord(key_id, name, _digest(key), scope, kept, rates, now, expires_at)
        self._keys.add(record)
        self._ring = None
        return record, key

    def all(self) -> list[KeyRecord]:
        """All keys, also those that are no longer in force, oldest first."""
        return self._keys.all()

    def revoke(self, name: str, now: datetime) -> KeyRecord:
        """End a key for ever; raises NotFound when no key in force has this name."""
        self._ring = None
        return self._keys.revoke(name, now)

    def remove(self, key_id: str) -> None:
        """Forget a key that nobody was given."""
        self._ring = None
        self._keys.remove(key_id)

    def clear(self) -> int:
        """Forget all keys, so that callers need none; returns how many there were."""
        self._ring = None
        return self._keys.remove()

    def fresh(self) -> KeyRing | None:
        """The keys as read at most `FRESH_S` seconds ago; None when they have to be read anew."""
        ring = self._ring
        return ring if ring is not None and self._monotonic() - ring.read_at < FRESH_S else None

    def read(self) -> KeyRing:
        """Read the keys."""
        began = self._monotonic()  # a key revoked while they are read has to be noticed next time
        ring = KeyRing({record.id: record for record in self._keys.all()}, began)
        self._ring = ring
        return ring

    def is_noted(self, access: Access, now: datetime) -> bool:
        """Whether the hour in which a key is used has been written down."""
        return access.key_id is None or self._noted.get(access.key_id) == _hour(now)

    def note(self, access: Access, now: datetime) -> None:
        """Write down that a key is used in this hour."""
        if access.key_id is not None and not self.is_noted(access, now):
            self._noted[access.key_id] = _hour(now)
            self._keys.used(access.key_id, _hour(now))


def new_key() -> tuple[str, str]:
    """A new id and key."""
    key_id = secrets.token_hex(6)
    body = f"rv_{key_id}_" + "".join(secrets.choice(_ALPHABET) for _ in range(_SECRET_LENGTH))
    return key_id, body + checksum(body)


def checksum(body: str) -> str:
    """CRC-32 of text in 6 letters and digits; for scanners, not for safety."""
    rest, letters = zlib.crc32(body.encode("ascii")), ""
    for _ in range(_CHECK_LENGTH):
        rest, digit = divmod(rest, len(_ALPHABET))
        letters = _ALPHABET[digit] + letters
    return letters


def _digest(key: str) -> bytes:
    return hashlib.sha256(key.encode("utf-8", "replace")).digest()


def _hour(now: datetime) -> datetime:
    return now.replace(minute=0, second=0, microsecond=0)
