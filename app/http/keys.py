"""Middleware that asks for a key before a body is read, and the parameters that keep a caller to its maps."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Protocol

from fastapi import Depends, Request
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.http.notes import note
from app.http.rate_limits import Buckets, client_of
from app.http.refusing import refuse
from app.http.scopes import OPEN_PATHS, Demand, demand
from schemas.errors import Busy, Forbidden, RevisitError, Unauthorized, Unavailable
from schemas.keys import ANONYMOUS, UNRESTRICTED, Access
from schemas.threads import Threads
from worker.service.keys import KeyRing

logger = logging.getLogger("revisit.http")

FAILURES = 30
"""Requests a minute with a wrong key, or none, that an address is answered 401; those beyond are answered 429."""

UNREADABLE_RETRY_S = 5

OPEN_PATIENCE_S = 0.1
"""Seconds that a path which needs no key waits for the keys to be read: probes are answered within half a second."""


class Keys(Protocol):
    """What the middleware needs of `worker.service.keys.KeyService`."""

    def fresh(self) -> KeyRing | None:
        """The keys as read a moment ago; None when they have to be read anew."""
        ...

    def read(self) -> KeyRing:
        """Read the keys."""
        ...

    def is_noted(self, access: Access, now: datetime) -> bool:
        """Whether the hour in which a key is used has been written down."""
        ...

    def note(self, access: Access, now: datetime) -> None:
        """Write down that a key is used in this hour."""
        ...


class NoKeys:
    """A service that never asks for a key."""

    def fresh(self) -> KeyRing:
        """No keys."""
        return KeyRing({}, 0.0)

    read = fresh

    def is_noted(self, access: Access, now: datetime) -> bool:
        """Nothing is written down."""
        return True

    def note(self, access: Access, now: datetime) -> None:
        """Nothing is written down."""


class KeyGate:
    """Answers 401 and 403 to callers whose key does not do, and tells the routes what the others may.

    The scope, and a map that the path names, are checked here; a map among the parameters when they are read
    (`check_map`), and that of a view, job or query when it is looked up.
    """

    def __init__(self, app: ASGIApp, keys: Keys) -> None:
        self._app, self._keys = app, keys
        # A thread of its own: keys are asked for while all others are busy. Another one writes, which may take a minute
        # while somebody else does: no request waits for it.
        self._thread = Threads(1, "revisit-keys")
        self._notes = Threads(1, "revisit-key-use")
        self._noting: set[str | None] = set()
        self._reading: asyncio.Task[KeyRing] | None = None
        self._failures = Buckets()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it before its body is read."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path, headers = scope["path"], Headers(scope=scope)
        try:
            access = await self._access(headers, None if path in OPEN_PATHS else client_of(scope))
            if path not in OPEN_PATHS:
                _check(access, demand(scope["method"], path))
        except RevisitError as error:
            if path not in OPEN_PATHS:
                await refuse(error, scope, receive, send)
                return
            access = ANONYMOUS
        scope["state"]["access"] = access
        scope["state"]["check_again"] = partial(self._check_again, headers, scope["method"], path)
        now = datetime.now(UTC)
        if access.key_id not in self._noting and not self._keys.is_noted(access, now):
            self._noting.add(access.key_id)
            self._notes.submit(self._note, access, now)
        await self._app(scope, receive, send)

    async def _access(self, headers: Headers, client: str | None) -> Access:
        """What the sender of a request may do; a failure counts against `client`, if any."""
        ring = self._keys.fresh() or await self._read(OPEN_PATIENCE_S if client is None else None)
        if not ring.closed:
            return UNRESTRICTED
        try:
            return ring.access(presented(headers), datetime.now(UTC))
        except Unauthorized:
            # Counted only here: whoever sends a right key is never refused for what its neighbours send.
            wait = 0 if client is None else self._failures.take(client, FAILURES, 1)
            if wait:
                note(limit="guesses")
                raise Busy(
                    f"too many requests without a valid key come from your address; wait {wait} s", wait
                ) from None
            raise

    async def _check_again(self, headers: Headers, method: str, path: str) -> None:
        """Raise what a request would be refused with if it came now: an answer may take longer than its key lasts."""
        ring = self._keys.fresh() or await self._read(None)
        if ring.closed:
            _check(ring.access(presented(headers), datetime.now(UTC)), demand(method, path))

    async def _read(self, patience_s: float | None) -> KeyRing:
        """Read the keys once for all requests that wait for them; raises Unavailable after `patience_s`."""
        if self._reading is None or self._reading.done():
            self._reading = asyncio.create_task(self._read_once())
            self._reading.add_done_callback(lambda task: task.exception())  # which nobody may be waiting for any more
        reading = self._reading
        await asyncio.wait([reading], timeout=patience_s)
        if not reading.done():
            raise Unavailable("the keys have not been read yet", UNREADABLE_RETRY_S)
        return reading.result()

    async def _read_once(self) -> KeyRing:
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, self._keys.read)
        except Unavailable as error:  # the disk or the database server, which tells by itself
            logger.warning("the keys cannot be read: %s", error.detail, extra={"event": "keys_unreadable"})
            raise
        except Exception:
            logger.exception("the keys cannot be read", extra={"event": "keys_unreadable"})
            raise Unavailable("the keys cannot be read at the moment", UNREADABLE_RETRY_S) from None

    def _note(self, access: Access, now: datetime) -> None:
        try:
            self._keys.note(access, now)
        except Exception as error:  # a full disk, say: no reason to refuse the caller
            logger.warning("use of a key was not noted: %s", type(error).__name__, extra={"event": "key_use_not_noted"})
        finally:
            self._noting.discard(access.key_id)


def presented(headers: Headers) -> str | None:
    """The key that a request sends (RFC 6750, 2.1, or ``X-Api-Key``), None without one.

    Another scheme of Authorization, such as a proxy's Basic, is not for this service.

    Raises
    ------
    Unauthorized
        Several keys that differ.
    """
    found = set(headers.getlist("x-api-key"))
    for value in headers.getlist("authorization"):
        scheme, _, key = value.strip().partition(" ")
        if scheme.lower() == "bearer":
            found.add(key.strip())
    if len(found) > 1:
        raise Unauthorized("the request sends two keys that differ; send one")
    return found.pop() if found else None


def _check(access: Access, wanted: Demand) -> None:
    if not access.may(wanted.scope):
        raise Forbidden(f"the key {access.key!r} has the scope {access.scope}; this needs {wanted.scope}")
    if wanted.all_maps and access.maps is not None:
        raise Forbidden(f"the key {access.key!r} is for some maps; this shows all of them")
    if wanted.map_name is not None:
        check_map(access, wanted.map_name)


def check_map(access: Access, map_name: str | None) -> None:
    """Raise Forbidden when the caller may not use a map, whether or not there is one of this name."""
    if map_name is not None and not access.may_use(map_name):
        raise Forbidden(f"the key {access.key!r} may not use the map {map_name!r}")


async def _access(request: Request) -> Access:
    access: Access = request.state.access
    return access


Accesses = Annotated[Access, Depends(_access)]
"""What the caller may do."""


async def _check_again(request: Request) -> Callable[[], Awaitable[None]]:
    check: Callable[[], Awaitable[None]] = request.state.check_again
    return check


ChecksAgain = Annotated[Callable[[], Awaitable[None]], Depends(_check_again)]
"""Raises what the request would be refused with if it came now, for answers that last."""
