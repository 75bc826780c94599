"""MQTT: what queries found, published to a broker of the operator's.

MQTT 3.1.1 with quality of service 1 (at least once). Publishing never delays a caller: while the broker is away events
wait in memory, bounded, and are lost when the service ends before it is back.
"""

import json
import logging
import secrets
import ssl
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any
from urllib.parse import unquote, urlsplit

from app.http.query_events import PATIENCE_S, WAITING, Outcome, event, kind_of
from schemas.errors import SetupError
from schemas.settings import Settings
from schemas.wire import QueryAnswer

logger = logging.getLogger("revisit.http")

PORTS = {"mqtt": 1883, "mqtts": 8883}

KEEP_ALIVE_S = 30
"""Seconds after which a connection without traffic is tried."""

AGAIN_S = (1, 60)
"""Shortest and longest time before a lost connection is tried again."""

EXTRA = "REVISIT_MQTT needs the package paho-mqtt: pip install paho-mqtt (the extra 'mqtt'), or leave REVISIT_MQTT out"


class Mqtt:
    """Publishes events as ``TOPIC/MAP/KIND``, and ``online`` or ``offline`` as the retained ``TOPIC/status``.

    Parameters
    ----------
    address : str
        ``mqtt://[user@]host[:port]``, or ``mqtts`` for TLS.
    password : str or None
    topic : str
        First levels of all topics.

    Raises
    ------
    SetupError
        The package that speaks MQTT is not installed.
    """

    name = "mqtt"

    def __init__(self, address: str, password: str | None, topic: str) -> None:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError:
            raise SetupError(EXTRA) from None
        to = urlsplit(address)
        self._host, self._port, self._topic = to.hostname or "", to.port or PORTS[to.scheme], topic
        # A name of its own for as long as it lives: without one each connection is somebody else to the broker, which
        # then gives the will of a connection that broke unseen after this is online again.
        self._client = Client(CallbackAPIVersion.VERSION2, f"revisit-{secrets.token_hex(7)}")
        if to.username:
            self._client.username_pw_set(unquote(to.username), password)
        if to.scheme == "mqtts":
            self._client.tls_set(cert_reqs=ssl.CERT_REQUIRED)
        self._client.max_queued_messages_set(0)  # `tell` bounds the events; the status has its place beside them
        self._client.reconnect_delay_set(*AGAIN_S)
        self._client.will_set(f"{topic}/status", "offline", qos=1, retain=True)
        self._client.on_connect, self._client.on_disconnect = self._connected, self._disconnected
        self._client.on_connect_fail, self._client.on_publish = self._failed, self._taken
        # Never held while the client is called, which holds locks of its own when it calls `_taken`.
        self._lock, self._all_taken = threading.Lock(), threading.Event()
        self._all_taken.set()
        self._waiting: set[int] = set()
        self._taken_early: set[int] = set()  # before `publish` had returned their numbers
        self._of_status: set[int] = set()
        self._told: str | None = None
        self._closing = False
        self._count: Callable[[Outcome], None] = lambda outcome: None

    @classmethod
    def of(cls, settings: Settings) -> "Mqtt | None":
        """As the settings say; None where they name no broker."""
        if settings.mqtt is None:
            return None
        password = None if settings.mqtt_password is None else settings.mqtt_password.get_secret_value()
        return cls(settings.mqtt, password, settings.mqtt_topic)

    def on_outcome(self, count: Callable[[Outcome], None]) -> None:
        """Have `count` called with what becomes of each event."""
        self._count = count

    def start(self) -> None:
        """Connect, in the background and again whenever the connection is lost."""
        self._client.connect_async(self._host, self._port, KEEP_ALIVE_S)
        self._client.loop_start()

    def tell(self, answer: QueryAnswer) -> None:
        """Publish what a query found; returns at once."""
        kind = kind_of(answer)
        body = json.dumps(event(kind, answer, datetime.now(UTC)), separators=(",", ":"))
        with self._lock:
            full = len(self._waiting) >= WAITING
            client = None if self._closing else self._client
        if full or client is None:
            self._lose("the service stopped" if client is None else f"more than {WAITING} wait")
            return
        sent = client.publish(f"{self._topic}/{answer.map}/{kind}", body, qos=1).mid
        with self._lock:
            if sent in self._taken_early:
                self._taken_early.remove(sent)
            else:
                self._waiting.add(sent)
                self._all_taken.clear()

    def close(self, patience_s: float = PATIENCE_S) -> None:
        """Wait for the broker to take what waits, for at most some seconds, and end."""
        until = time.monotonic() + patience_s
        with self._lock:
            if self._closing:
                return
            self._closing = True
        self._all_taken.wait(patience_s)
        with self._lock:
            left = len(self._waiting)
            self._waiting.clear()
        if self._client.is_connected():
            told = self._client.publish(f"{self._topic}/status", "offline", qos=1, retain=True)
            told.wait_for_publish(max(0.1, until - time.monotonic()))
        self._client.disconnect()
        # Its thread may be connecting, which takes as long as it takes, and so would waiting for it.
        ending = threading.Thread(target=self._client.loop_stop, name="revisit-mqtt-end", daemon=True)
        ending.start()
        ending.join(max(0.1, until - time.monotonic()))
        del self._client  # it closes its sockets once nothing refers to it
        for _ in range(left):
            self._lose("the service stopped")

    def _lose(self, why: str) -> None:
        logger.warning("an event is lost to MQTT: %s", why, extra={"event": "mqtt_lost"})
        self._count("dropped")

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._say(f"the broker of MQTT at {self._host}:{self._port} refuses the connection: {reason}")
            return
        self._say(None)
        self._of_status.add(client.publish(f"{self._topic}/status", "online", qos=1, retain=True).mid)

    def _disconnected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure and not self._closing and self._told is None:  # else: of one that never stood
            self._say(f"the connection to the broker of MQTT at {self._host}:{self._port} was lost; events wait")

    def _failed(self, client: Any, userdata: Any) -> None:
        broker = f"the broker of MQTT at {self._host}:{self._port}"
        error = sys.exception()  # that this is called for
        if isinstance(error, ssl.SSLCertVerificationError):
            self._say(f"{broker} shows a certificate that is not trusted ({error.verify_message}); events wait")
        else:
            self._say(f"{broker} cannot be reached; events wait")

    def _taken(self, client: Any, userdata: Any, mid: int, reason: Any, properties: Any) -> None:
        if mid in self._of_status:
            self._of_status.remove(mid)
            return
        with self._lock:
            if mid in self._waiting:
                self._waiting.remove(mid)
                if not self._waiting:
                    self._all_taken.set()
            elif self._closing:  # of the status, or told to be lost already
                return
            else:
                self._taken_early.add(mid)
        self._count("delivered")

    def _say(self, trouble: str | None) -> None:
        """Log a trouble once, not at every attempt, and that it is over."""
        if trouble is not None and trouble != self._told:
            logger.warning(trouble, extra={"event": "mqtt_trouble"})
        elif trouble is None and self._told is not None:
            logger.info("the broker of MQTT is there again")
        self._told = trouble
