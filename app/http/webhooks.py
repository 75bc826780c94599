"""Webhooks: what queries found, sent to an address of the operator's, signed, and again until it is taken.

As Standard Webhooks 1.0 says (headers ``webhook-id``, ``webhook-timestamp``, ``webhook-signature``), so that its
libraries verify them. Sending never delays a caller: events wait in memory, and are lost when the service ends before
they are taken, or when too many wait: the oldest first.
"""

import base64
import hashlib
import heapq
import hmac
import json
import logging
import random
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime

import httpx

from app.http.deadline import Deadline
from app.http.query_events import PATIENCE_S, WAITING, Outcome, event, kind_of
from schemas.errors import NOT_CALLED, SetupError
from schemas.settings import Settings
from schemas.wire import QueryAnswer

logger = logging.getLogger("revisit.http")

DELAYS_S = (5.0, 30.0, 120.0, 600.0, 1800.0)
"""Seconds before each further attempt, give or take a tenth."""

TIMEOUT_S = 10.0
"""Of an attempt, from the first byte of the connection to the end of the answer's headers."""

SHORT_BYTES, BODY_S = 65536, 1.0
"""Bytes of an answer that is read, and seconds for that, so that the next event goes by the same connection."""

IDLE_S = 2.0
"""Seconds for which a connection is kept without events; receivers close theirs after five or more."""

PREFIX = "whsec_"
"""Of a secret that is base64."""

AGAIN = frozenset({408, 425, 429})
"""Statuses below 500 that say to try again."""


@dataclass(order=True)
class _Event:
    due: float
    number: int
    id: str = field(compare=False)
    body: bytes = field(compare=False)
    attempts: int = field(default=0, compare=False)


class Webhooks:
    """Sends events.

    Parameters
    ----------
    url : str
    secret : str or None
        ``whsec_`` and base64, or any text; None sends unsigned.
    kinds : collection of str
        Of ``matched``, ``no_match`` and ``look-alike``: what is sent.
    delays_s : sequence of float
        Before each further attempt.

    Raises
    ------
    SetupError
        The environment names a proxy or certificates that cannot be used.
    """

    name = "webhooks"

    def __init__(
        self, url: str, secret: str | None, kinds: Sequence[str], delays_s: Sequence[float] = DELAYS_S
    ) -> None:
        self._url, self._secret, self._kinds, self._delays_s = url, secret, frozenset(kinds), tuple(delays_s)
        self._lock, self._changed = threading.Lock(), threading.Event()
        self._waiting: list[_Event] = []
        self._number = 0
        self._ends_at: float | None = None
        self._thread: threading.Thread | None = None
        self._deadline = Deadline()
        self._count: Callable[[Outcome], None] = lambda outcome: None
        try:
            kept = httpx.Limits(keepalive_expiry=IDLE_S)
            self._client = httpx.Client(timeout=TIMEOUT_S, headers={"user-agent": "revisit"}, limits=kept)
        except (ImportError, OSError, ValueError, httpx.InvalidURL) as error:
            raise SetupError(NOT_CALLED.format("REVISIT_WEBHOOK", error)) from error

    @classmethod
    def of(cls, settings: Settings) -> "Webhooks | None":
        """As the settings say; None where they name no address."""
        if settings.webhook is None:
            return None
        secret = None if settings.webhook_secret is None else settings.webhook_secret.get_secret_value()
        return cls(settings.webhook, secret, settings.webhook_kinds)

    def on_outcome(self, count: Callable[[Outcome], None]) -> None:
        """Have `count` called with what becomes of each event."""
        self._count = count

    def start(self) -> None:
        """Begin to send what waits and what comes."""
        self._thread = threading.Thread(target=self._run, name="revisit-webhooks", daemon=True)
        self._thread.start()

    def tell(self, answer: QueryAnswer) -> None:
        """Send what a query found, if such events are wanted; returns at once."""
        kind = kind_of(answer)
        if kind not in self._kinds:
            return
        body = json.dumps(event(kind, answer, datetime.now(UTC)), separators=(",", ":")).encode()
        with self._lock:
            if self._ends_at is not None:
                return
            self._number += 1
            heapq.heappush(self._waiting, _Event(time.monotonic(), self._number, answer.query.id, body))
            dropped = None
            if len(self._waiting) > WAITING:
                dropped = min(self._waiting, key=lambda one: one.number)
                self._waiting.remove(dropped)
                heapq.heapify(self._waiting)
            self._changed.set()
        if dropped is not None:
            self._settle(dropped, "dropped", f"more than {WAITING} wait")

    def close(self, patience_s: float = PATIENCE_S) -> None:
        """Try what waits once more, for at most some seconds, and end."""
        with self._lock:
            self._ends_at = time.monotonic() + patience_s
            self._changed.set()
        self._deadline.hurry(patience_s)
        if self._thread is not None:
            self._thread.join(patience_s + 1)
        with self._lock:
            left, self._waiting = self._waiting, []
        for one in left:
            self._settle(one, "dropped", "the service stopped")

    def _run(self) -> None:
        with self._client as client:
            while (one := self._next()) is not None:
                said = self._send(client, one)
                if said is None:
                    self._settle(one, "delivered", "")
                elif said.final:
                    self._settle(one, "refused", said.text)
                elif one.attempts > len(self._delays_s) or self._ends_at is not None:
                    self._settle(one, "given_up", said.text)
                else:
                    self._try_later(one, said.text)

    def _try_later(self, one: "_Event", why: str) -> None:
        delay = self._delays_s[one.attempts - 1] * random.uniform(0.9, 1.1)
        logger.info("webhook %s: %s; again in %.0f s", one.id, why, delay)
        with self._lock:
            one.due = time.monotonic() + delay
            heapq.heappush(self._waiting, one)

    def _next(self) -> "_Event | None":
        """The next event, once it is due; None at the end."""
        while True:
            self._changed.clear()
            with self._lock:
                now = time.monotonic()
                if self._ends_at is not None:  # what waits to be tried again is tried now
                    return heapq.heappop(self._waiting) if self._waiting and now < self._ends_at else None
                if self._waiting and self._waiting[0].due <= now:
                    return heapq.heappop(self._waiting)
                wait_s = self._waiting[0].due - now if self._waiting else None
            self._changed.wait(wait_s)

    def _send(self, client: httpx.Client, one: _Event) -> "_Failure | None":
        one.attempts += 1
        sent_at = int(time.time())
        headers = {"content-type": "application/json", "webhook-id": one.id, "webhook-timestamp": str(sent_at)}
        if self._secret is not None:
            headers["webhook-signature"] = signature(self._secret, one.id, sent_at, one.body)
        timeout = TIMEOUT_S if self._ends_at is None else max(0.1, self._ends_at - time.monotonic())
        traced = {"trace": self._deadline.trace}
        try:
            with (
                self._deadline.within(timeout),
                client.stream(
                    "POST", self._url, content=one.body, headers=headers, timeout=timeout, extensions=traced
                ) as answer,
            ):
                self._read_short(answer)
        except (httpx.HTTPError, httpx.InvalidURL, UnicodeError) as error:  # UnicodeError: a host that cannot be named
            why = "no whole answer in time" if self._deadline.is_over else type(error).__name__
            return _Failure(f"{why} after attempt {one.attempts}")
        if answer.is_success:
            return None
        final = answer.status_code < 500 and answer.status_code not in AGAIN
        elsewhere = ", a redirect, which is not followed" if answer.is_redirect else ""
        return _Failure(f"answered {answer.status_code} to attempt {one.attempts}{elsewhere}", final)

    def _read_short(self, answer: httpx.Response) -> None:
        """Read what follows the headers where it is short; all else ends the connection, since it may never end."""
        length = answer.headers.get("content-length", "0" if answer.status_code == 204 else "")
        if length.isdecimal() and len(length) < 10 and int(length) <= SHORT_BYTES:
            self._deadline.hurry(BODY_S)
            with suppress(httpx.HTTPError):
                answer.read()

    def _settle(self, one: _Event, outcome: Outcome, why: str) -> None:
        if outcome != "delivered":
            logger.warning("webhook %s is lost: %s", one.id, why, extra={"event": "webhook_lost", "outcome": outcome})
        self._count(outcome)


@dataclass(frozen=True)
class _Failure:
    text: str
    final: bool = False


def signature(secret: str, id: str, timestamp: int, body: bytes) -> str:
    """The header ``webhook-signature``: HMAC-SHA256 of id, time and body (Standard Webhooks, "Signature scheme")."""
    key = secret.encode()
    if secret.startswith(PREFIX):
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    digest = hmac.new(key, b"%b.%d.%b" % (id.encode(), timestamp, body), hashlib.sha256).digest()
    return f"v1,{base64.b64encode(digest).decode()}"
