"""API keys as records: what a key allows, how much of it, and for how long."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal, get_args

Scope = Literal["read", "write", "admin"]
"""What a key allows; each scope includes those before it."""

SCOPES: tuple[Scope, ...] = get_args(Scope)


@dataclass(frozen=True)
class Rates:
    """Most of each that may come in a minute; None: the settings decide, 0: as much as wanted.

    Parameters
    ----------
    requests : int or None
    images : int or None
    mb : float or None
        Bodies, in 10^6 bytes.
    """

    requests: int | None = None
    images: int | None = None
    mb: float | None = None


@dataclass(frozen=True)
class Access:
    """What a caller may do.

    Parameters
    ----------
    scope : Scope
    maps : frozenset of str or None
        The maps it may use; None: all.
    key : str or None
        Name of the caller's key.
    key_id : str or None
        Id of the caller's key.
    rates : Rates
        Limits of its own.
    """

    scope: Scope
    maps: frozenset[str] | None = None
    key: str | None = None
    key_id: str | None = None
    rates: Rates = Rates()

    def may(self, scope: Scope) -> bool:
        """Whether the caller has a scope, or one that includes it."""
        return SCOPES.index(scope) <= SCOPES.index(self.scope)

    def may_use(self, map_name: str) -> bool:
        """Whether the caller may use a map."""
        return self.maps is None or map_name in self.maps

    def own(self, name: str) -> str:
        """A name that the caller gave something, told apart from the same name given with any other key."""
        return name if self.key_id is None else f"{name} of {self.key_id}"


UNRESTRICTED = Access("admin")
"""Of every caller of a service without keys."""

ANONYMOUS = Access("read", frozenset())
"""Of a caller without a key where none is needed although there are keys: no map is named to it."""


@dataclass(frozen=True)
class KeyRecord:
    """A key as it is kept: never the secret.

    Parameters
    ----------
    id : str
        Public part of the key.
    name : str
        The operator's own; no two keys that are in force share one.
    digest : bytes
        SHA-256 of the whole key.
    scope : Scope
    maps : tuple of str or None
        None: all maps.
    rates : Rates
    created_at : datetime
    expires_at, revoked_at : datetime or None
    last_used_at : datetime or None
        To the hour.
    """

    id: str
    name: str
    digest: bytes = field(repr=False)
    scope: Scope
    maps: tuple[str, ...] | None
    rates: Rates
    created_at: datetime
    expires_at: datetime | None = None
    revoked_at: datetime | None = None
    last_used_at: datetime | None = None

    @property
    def access(self) -> Access:
        """What the key's holder may do."""
        return Access(self.scope, None if self.maps is None else frozenset(self.maps), self.name, self.id, self.rates)

    def state(self, now: datetime) -> Literal["valid", "expired", "revoked"]:
        """Whether the key is in force."""
        if self.revoked_at is not None:
            return "revoked"
        return "expired" if self.expires_at is not None and self.expires_at <= now else "valid"
