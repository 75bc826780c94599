"""Middleware around every route: request id, access log, metrics, readiness, bounds of the body. ASGI, no buffering."""

import asyncio
import logging
import re
import secrets
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.body import announced_bytes, has_body
from app.http.body_room import LET_GO, MEMORY, BodyRoom
from app.http.limits import CROWDED, SLOWEST_BYTES_S
from app.http.metrics import Metrics
from app.http.notes import Notes, noting
from app.http.problems import internal
from app.http.refusing import refuse
from schemas.errors import BadBody, BodyTooLarge, RequestTimeout, Unavailable
from schemas.log_context import bound
from schemas.settings import MEGA, Settings

access = logging.getLogger("revisit.access")

_SANE_ID = re.compile(r"[A-Za-z0-9._-]{1,128}")
_IMPORTS = re.compile("/maps/[^/]+/imports")
_PACKED = re.compile(r"\b(x-)?(gzip|compress|deflate|br|zstd)\b", re.IGNORECASE)
"""Codings of a body (RFC 9110, 8.4.1) that it would have to be unpacked from, beyond its bounds."""

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})

ALWAYS_OPEN = frozenset({"/livez", "/readyz", "/metrics"})
"""Paths that answer while the service starts and stops, so that supervisors can watch it."""

STREAMED = frozenset({("POST", "/restore")})
"""Requests whose body is received into a file."""

STARTING_RETRY_S = 2
DRAINING_RETRY_S = 10
CROWDED_RETRY_S = 2

_OF_EVERY_ANSWER = {
    # A browser must not interpret an enrolled image as a page, nor let other sites read or show it. Pages for people
    # set a policy of their own.
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'; sandbox",
    "Cross-Origin-Resource-Policy": "same-origin",
    # Addresses hold ids, names of maps and positions.
    "Referrer-Policy": "no-referrer",
}


class RequestContext:
    """Outermost: gives each request an id, logs and counts its answer, and answers 500 to uncaught exceptions.

    Parameters
    ----------
    app : ASGIApp
    metrics : Metrics
    draining : callable
        Whether the service is stopping: then each connection ends with its answer.
    slow_s : float
        Requests that take longer are logged as warnings, seconds.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics, draining: Callable[[], bool], slow_s: float = 5) -> None:
        self._app = app
        self._metrics = metrics
        self._draining = draining
        self._slow_s = slow_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begin = time.perf_counter()
        given = Headers(scope=scope).get("x-request-id", "")
        request_id = given if _SANE_ID.fullmatch(given) else secrets.token_hex(16)
        scope.setdefault("state", {})["request_id"] = request_id
        status = received = sent = 0
        seconds: float | None = None
        unread = has_body(scope)

        async def receive_watched() -> Message:
            nonlocal received, unread
            message = await receive()
            received += len(message.get("body", b""))
            if not message.get("more_body", False):
                unread = False
            return message

        async def send_with_id(message: Message) -> None:
            nonlocal status, sent, seconds
            sent += len(message.get("body", b""))
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                if headers.get("content-type", "").startswith("text/event-stream"):
                    seconds = time.perf_counter() - begin  # events last as long as what they tell of
                headers["X-Request-Id"] = request_id
                for name, value in _OF_EVERY_ANSWER.items():
                    headers.setdefault(name, value)
                # Whoever has a key may keep what it gives, and asks each time; what stands between keeps nothing:
                # caches know of Authorization that answers are one caller's, and not of X-Api-Key.
                headers.setdefault("Cache-Control", "no-store" if status >= 400 else "private, no-cache")
                if unread or self._draining():
                    # With the rest of a body unread, or no service to come back to, no other request can follow.
                    headers["Connection"] = "close"
            await send(message)

        with bound(request_id=request_id), noting(scope["path"]) as notes, self._metrics.in_flight.track_inprogress():
            try:
                await self._app(scope, receive_watched, send_with_id)
            except asyncio.CancelledError:
                if status or not self._draining():
                    raise
                await refuse(
                    Unavailable("the service stopped before this was done; it may be done or not", DRAINING_RETRY_S),
                    scope,
                    receive,
                    send_with_id,
                )
            except Exception as error:
                response = internal(error, request_id)
                if status == 0:
                    await response(scope, receive, send_with_id)
                else:
                    # The status line is sent: only breaking the connection can still tell the client of the failure.
                    raise
            finally:
                seconds = time.perf_counter() - begin if seconds is None else seconds
                self._record(scope, notes, status, seconds, received, sent)

    def _record(self, scope: Scope, notes: Notes, status: int, seconds: float, received: int, sent: int) -> None:
        """Count the request, and write its one log line."""
        route: Any = scope.get("route")
        template = getattr(route, "path", "unmatched")
        method = scope["method"] if scope["method"] in _METHODS else "other"
        self._metrics.answered(method, template, status, seconds, received=received, sent=sent)
        for code in notes.problems:
            self._metrics.refused(code, _reason(notes.fields.get("limit")))
        slow = seconds > self._slow_s
        # The path without its query string: positions and metadata are private to the caller.
        access.log(
            logging.WARNING if slow or status == 500 else logging.INFO,
            "%s %s %d",
            method,
            scope["path"],
            status,
            extra={
                "event": "request",
                "method": method,
                "path": scope["path"],
                "route": template,
                "status": status,
                "ms": round(seconds * 1000, 2),
                "request_bytes": received,
                "response_bytes": sent,
                "request_id": scope["state"]["request_id"],
                "key": getattr(scope["state"].get("access"), "key", None),
                **({"slow": True} if slow else {}),
                **({"problem": notes.problems[0]} if notes.problems else {}),
                **notes.fields,
            },
        )


class Failures:
    """Answers 500 to uncaught exceptions inside `app.http.cors`, without which a page could not read that answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request; an exception after its answer has begun goes on to `RequestContext`."""
        begun = False

        async def send_seen(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, send_seen)
        except Exception as error:
            if begun or scope["type"] != "http":
                raise
            await internal(error, scope["state"]["request_id"])(scope, receive, send)


class ReadinessGate:
    """Answers 503 while the service starts or drains, or when too many connections are open."""

    def __init__(self, app: ASGIApp, state: Callable[[], tuple[bool, bool]]) -> None:
        self._app = app
        self._state = state  # (started, draining) at this moment

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or say when to come back."""
        if scope["type"] != "http" or scope["path"] in ALWAYS_OPEN:
            await self._app(scope, receive, send)
            return
        started, draining = self._state()
        if draining:
            await refuse(Unavailable("the service is stopping", DRAINING_RETRY_S), scope, receive, send)
        elif not started:
            await refuse(Unavailable("the service is starting", STARTING_RETRY_S), scope, receive, send)
        elif scope.get("state", {}).get(CROWDED):
            await refuse(Unavailable("too many connections are open", CROWDED_RETRY_S), scope, receive, send)
        else:
            await self._app(scope, receive, send)


class BodyLimit:
    """Refuses bodies that are too large, by Content-Length before reading, else while reading; that arrive too late, or
    are packed.

    Parameters
    ----------
    app : ASGIApp
    settings : Settings
        ``max_body_mb``, ``max_import_mb`` for recordings, and ``body_s``: the seconds in which a body has to arrive,
        and one more for each `SLOWEST_BYTES_S` bytes that have arrived. Those of `STREAMED` have no bound here: the
        disk bounds them. ``bodies_mb``: what the others may take together, as `BodyRoom` says.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._most = round(settings.max_body_mb * MEGA)
        self._most_imported = round(settings.max_import_mb * MEGA)
        self._seconds = settings.body_s
        self._room = BodyRoom(round(settings.bodies_mb * MEGA), self._most)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request whose body is counted while it is read."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        recording = _IMPORTS.fullmatch(scope["path"]) is not None
        most = self._most_imported if recording else self._most
        headers = Headers(scope=scope)
        announced = announced_bytes(headers)
        bounded = (scope["method"], scope["path"]) not in STREAMED
        packed = _PACKED.search(headers.get("content-encoding", ""))
        if packed is not None and has_body(scope):
            detail = f"the body is packed (Content-Encoding: {packed[0]}); send it unpacked, without that header"
            await refuse(BadBody("malformed-body", detail), scope, receive, send)
            return
        if bounded and announced > most:
            await refuse(_too_large(f"{announced:,}", most), scope, receive, send)
            return
        received = 0
        complete = not has_body(scope)
        begin = time.monotonic()
        in_memory = bounded and not recording
        body = self._room.open()
        scope.setdefault("state", {})[LET_GO] = partial(self._room.close, body)

        async def receive_counted() -> Message:
            nonlocal received, complete
            if complete:  # what follows is the end of the connection, which may be waited for
                return await receive()
            allowed = self._seconds + received / SLOWEST_BYTES_S
            try:
                async with body.wait(max(0.0, begin + allowed - time.monotonic())):
                    message = await receive()
            except TimeoutError:
                late = f"the body did not arrive within {allowed:.0f} s"
                if body.made_room:
                    late = f"the body took {time.monotonic() - begin:.0f} s and more, and others needed its memory"
                raise RequestTimeout(f"{late}; {received:,} bytes of it did arrive") from None
            complete = not message.get("more_body", False)
            if message["type"] == "http.request":
                received += len(message.get("body", b""))
                if bounded and received > most:
                    # Raised inside the route that reads the body, so that it is answered like any other refusal.
                    raise _too_large(f"more than {most:,}", most)
                if in_memory:
                    self._room.add(body, len(message.get("body", b"")))
            return message

        try:
            await self._app(scope, receive_counted, send)
        finally:
            self._room.close(body)


def _reason(limit: object) -> str | None:
    """Which limit it was that a request came up against, as `Metrics.refused` takes it."""
    return None if limit is None else MEMORY if limit == MEMORY else "rate"


def _too_large(size: str, most: int) -> BodyTooLarge:
    return BodyTooLarge(f"the body has {size} bytes; at most {most:,} are taken")
