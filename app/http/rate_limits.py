"""Limits a minute, for each client and for all together: requests, images, bytes of bodies.

Counted by the generic cell rate algorithm (ITU-T I.371): of each count only the moment is kept at which all that was
let in will have been paid off at the permitted rate. At most a minute's worth may come at once; over any span of `s`
seconds at most `limit * (1 + s / 60)` are let in, besides what could not be counted beforehand.

Requests and announced bytes are counted before a body is read, and so is one image. Further images of a body and bytes
that were not announced are counted when they have come: they are served, and the next requests wait for them.
"""

import ipaddress
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.body import announced_bytes
from app.http.notes import note
from app.http.refusing import refuse
from app.http.scopes import OPEN_PATHS
from schemas.errors import Busy
from schemas.keys import UNRESTRICTED, Access, Rates
from schemas.latest import Latest
from schemas.settings import MEGA, Settings

MINUTE = 60.0

MOST_BUCKETS = 10_000
"""Clients that are remembered; beyond, the one that was quiet for longest is forgotten."""

OVERALL = "*"

_IMAGES_ON = re.compile(r"/(enroll|query|localize/geopose|compat/.+/(faces|recognize|verify))")

_COMPARED_ON = re.compile(r"/(views|queries)/[^/]+/changes(\.png)?")
"""Where stored images are encoded to be compared: as much work as an image that is sent."""


class Buckets:
    """Buckets by name, all of them full at first.

    Parameters
    ----------
    clock : function
        Seconds of a clock that never goes back.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._paid_off: Latest[str, float] = Latest(MOST_BUCKETS)  # the moment at which a bucket is full again

    def wait(self, name: str, limit: float, cost: float) -> int:
        """Seconds, rounded up, until `cost` is let in; 0: now. At most `limit` a minute; 0: without limit.

        What costs more than a minute's worth is let in once the bucket is full.
        """
        if limit <= 0 or cost <= 0:
            return 0
        debt = max(0.0, self._paid_off.get(name, 0.0) - self._clock())
        return max(0, math.ceil(round(debt + MINUTE * min(cost, limit) / limit - MINUTE, 6)))

    def spend(self, name: str, limit: float, cost: float) -> None:
        """Count `cost`, let in or not."""
        if limit <= 0 or cost <= 0:
            return
        now = self._clock()
        self._paid_off[name] = max(now, self._paid_off.get(name, now)) + MINUTE * cost / limit

    def take(self, name: str, limit: float, cost: float) -> int:
        """`spend` when there is no `wait`; returns the wait."""
        wait = self.wait(name, limit, cost)
        if not wait:
            self.spend(name, limit, cost)
        return wait

    def left(self, name: str, limit: float) -> tuple[int, int]:
        """How much is let in now, and the seconds, rounded up, until the bucket is full."""
        debt = max(0.0, self._paid_off.get(name, 0.0) - self._clock())
        return max(0, math.floor(limit * (1 - debt / MINUTE) + 1e-6)), math.ceil(debt)

    def __len__(self) -> int:
        return len(self._paid_off)


@dataclass(frozen=True)
class Share:
    """One limit as it applies to a request.

    Parameters
    ----------
    bucket : str
    name : str
        ``requests``, ``images`` or ``bytes``.
    limit : float
        A minute; 0: none.
    """

    bucket: str
    name: str
    limit: float

    @property
    def overall(self) -> bool:
        """Whether all clients share it."""
        return self.bucket.startswith(OVERALL)


class RateLimit:
    """Answers 429 to clients that send more than their limits, or when all together do.

    Parameters
    ----------
    app : ASGIApp
    settings : Settings
        ``limit_...``; a key may have limits of its own.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app, self._buckets = app, Buckets()
        self._each = Rates(settings.limit_requests, settings.limit_images, settings.limit_mb)
        self._all = Rates(settings.limit_all_requests, settings.limit_all_images, settings.limit_all_mb)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or say when to come back."""
        if scope["type"] != "http" or scope["path"] in OPEN_PATHS:
            await self._app(scope, receive, send)
            return
        shares = self._shares(scope)
        if not shares:
            await self._app(scope, receive, send)
            return
        sent = announced_bytes(Headers(scope=scope))
        encoded_on = _IMAGES_ON if scope["method"] == "POST" else _COMPARED_ON
        image = encoded_on.fullmatch(scope["path"]) is not None
        costs = {"requests": 1, "images": int(image), "bytes": sent}

        async def send_with_limits(message: Message) -> None:
            if message["type"] == "http.response.start":
                self._describe(MutableHeaders(scope=message), shares)
            await send(message)

        waits = [(self._buckets.wait(share.bucket, share.limit, costs[share.name]), share) for share in shares]
        wait, share = max(waits, key=lambda one: one[0])
        if wait:
            note(limit=share.name)
            await refuse(_too_many(share, wait), scope, receive, send_with_limits)
            return
        self._spend(shares, costs)
        scope["state"]["spend_images"] = lambda count: self._spend(shares, {"images": count - 1})
        received = 0

        async def receive_counted() -> Message:
            nonlocal received
            message = await receive()
            if message["type"] == "http.request":
                received += len(message.get("body", b""))
            return message

        try:
            await self._app(scope, receive_counted, send_with_limits)
        finally:
            self._spend(shares, {"bytes": max(0, received - sent)})

    def _shares(self, scope: Scope) -> list[Share]:
        access: Access = scope["state"].get("access", UNRESTRICTED)
        client = client_of(scope) if access.key_id is None else f"key {access.key_id}"
        own, each = access.rates, self._each
        limits = {
            "requests": (each.requests if own.requests is None else own.requests, self._all.requests),
            "images": (each.images if own.images is None else own.images, self._all.images),
            "bytes": ((each.mb if own.mb is None else own.mb) or 0, self._all.mb),
        }
        return [
            Share(f"{bucket} {name}", name, limit * (MEGA if name == "bytes" else 1))
            for name, pair in limits.items()
            for bucket, limit in zip((client, OVERALL), pair, strict=True)
            if limit
        ]

    def _spend(self, shares: list[Share], costs: dict[str, int]) -> None:
        for share in shares:
            self._buckets.spend(share.bucket, share.limit, costs.get(share.name, 0))

    def _describe(self, headers: MutableHeaders, shares: list[Share]) -> None:
        """The client's own limits, as draft-ietf-httpapi-ratelimit-headers-10 writes them."""
        own = [share for share in shares if not share.overall]
        if own:
            headers["RateLimit-Policy"] = ", ".join(f'"{one.name}";q={one.limit:.0f};w=60' for one in own)
            left = [(one.name, *self._buckets.left(one.bucket, one.limit)) for one in own]
            headers["RateLimit"] = ", ".join(f'"{name}";r={rest};t={full}' for name, rest, full in left)


def _too_many(share: Share, wait: int) -> Busy:
    who = "all clients together" if share.overall else "you"
    return Busy(f"{who} may send {share.limit:,.0f} {share.name} a minute; try again in {wait} s", wait)


def charge_images(request: Request, count: int) -> None:
    """Count the images of a parsed body; the first was counted before."""
    spend = getattr(request.state, "spend_images", None)
    if spend is not None:
        spend(count)


def client_of(scope: Scope) -> str:
    """The caller's address; of IPv6 the network of 64 bits, which a caller has all of, unless it is IPv4 in IPv6."""
    host = (scope.get("client") or ("unknown", 0))[0]
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return str(host)
    if isinstance(address, ipaddress.IPv4Address):
        return str(host)
    # A socket that listens on `::` sees every IPv4 caller within one network.
    return str(address.ipv4_mapped or ipaddress.ip_network((int(address) >> 64 << 64, 64)))
