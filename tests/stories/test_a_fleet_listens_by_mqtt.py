"""MQTT: a fleet manager hears of what its robots found, through a real broker, and no query waits for that."""

import json
import logging
import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.http import mqtt
from app.http.application import create_app
from app.http.examples import QUERY_ANSWER
from app.http.mqtt import Mqtt
from app.http.webhooks import Webhooks
from schemas.errors import SetupError
from schemas.settings import read_settings
from schemas.wire import QueryAnswer
from tests.certificates import self_signed
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.stories.running import RunningService
from tests.waiting import PATIENCE_S, until
from worker.runtime import build

pytestmark = pytest.mark.one_database("events leave a process that serves, and are stored nowhere")

JPEG = {"content-type": "image/jpeg"}
MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
broker_needed = pytest.mark.skipif(MOSQUITTO is None, reason="needs mosquitto: apt-get install mosquitto")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(autouse=True)
def clients_have_ended() -> Iterator[None]:
    """A client that was connecting ends later than it is closed: no other test is blamed for its sockets."""
    yield
    until(lambda: not any(one.name.startswith(("paho", "revisit-mqtt")) for one in threading.enumerate()))


@contextmanager
def broker(
    folder: Path, port: int, password: str | None = None, tls: tuple[Path, Path] | None = None
) -> Iterator[None]:
    """mosquitto on a port, for anyone or for the user ``robot``; `tls`: files of its key and certificate."""
    lines = [f"listener {port} 127.0.0.1", f"allow_anonymous {str(password is None).lower()}"]
    if os.geteuid() == 0:
        lines.append("user root")
    if password is not None:
        users = folder / "users"
        subprocess.run(["mosquitto_passwd", "-b", "-c", users, "robot", password], check=True, capture_output=True)
        users.chmod(0o600)
        lines.append(f"password_file {users}")
    if tls is not None:
        lines += [f"keyfile {tls[0]}", f"certfile {tls[1]}"]
    settings = folder / "mosquitto.conf"
    settings.write_text("\n".join(lines) + "\n")
    assert MOSQUITTO is not None
    process = subprocess.Popen([MOSQUITTO, "-c", settings], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: not _refused(port))
        yield
    finally:
        process.kill()
        process.wait()


def _refused(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) != 0


class Listener:
    """A subscriber to everything, by the same library that the service uses; mosquitto stands between."""

    def __init__(self, port: int, password: str | None = None) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.messages: list[tuple[str, bytes]] = []
        subscribed = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2)
        if password is not None:
            self._client.username_pw_set("robot", password)
        self._client.on_message = lambda client, data, message: self.messages.append(
            (message.topic, bytes(message.payload))
        )
        self._client.on_subscribe = lambda *_: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe("#", qos=1)
        assert subscribed.wait(PATIENCE_S)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        self._client.on_message = None  # a circle, in which its sockets would be left


@contextmanager
def listening(port: int, password: str | None = None) -> Iterator[Listener]:
    one = Listener(port, password)
    try:
        yield one
    finally:
        one.close()


def answer(query: str) -> QueryAnswer:
    return QueryAnswer.model_validate({**QUERY_ANSWER, "query": {**QUERY_ANSWER["query"], "id": query}})


@broker_needed
def test_a_query_is_published_under_its_map_and_verdict(tmp_path: Path) -> None:
    port = free_port()
    named = {"REVISIT_MQTT": f"mqtt://robot@127.0.0.1:{port}", "REVISIT_MQTT_TOPIC": "building/3"}
    with broker(tmp_path, port, "let me in"), listening(port, "let me in") as fleet:
        with (
            RunningService(tmp_path / "data", REVISIT_MQTT_PASSWORD="let me in", **named) as service,
            httpx.Client(base_url=service.url, timeout=30) as client,
        ):
            assert client.post("/enroll?map=town&place=gate", content=photo(), headers=JPEG).status_code == 201
            found = client.post("/query?map=town", content=photo(), headers=JPEG).json()
            until(lambda: 'revisit_mqtt_total{outcome="delivered"} 1.0' in client.get("/metrics").text)
            until(lambda: len(fleet.messages) == 2)
            assert service.stop() == 0
        until(lambda: len(fleet.messages) == 3)
    (up, online), (topic, body), (down, offline) = fleet.messages
    assert (up, online, down, offline) == ("building/3/status", b"online", "building/3/status", b"offline")
    told: dict[str, Any] = json.loads(body)
    kind = "look-alike" if found["reason"]["code"] == "look-alike" else found["status"]
    assert (topic, told["type"]) == (f"building/3/town/{kind}", f"query.{kind}")
    assert (told["data"]["query"], told["data"]["place"]) == (found["query"]["id"], "gate")
    assert "let me in" not in "".join(service.output)


def test_webhooks_are_told_of_the_same_queries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, str]] = []
    for kind in (Webhooks, Mqtt):
        monkeypatch.setattr(kind, "tell", lambda self, answer: told.append((self.name, answer.query.id)))
    nobody = {"webhook": "http://127.0.0.1:1/", "mqtt": "mqtt://127.0.0.1:1"}
    settings = read_settings({}, data=tmp_path, encoder="color", threads=1, **nobody)
    with CheckedClient(create_app(build(settings))) as client:
        client.post("/enroll?map=town", content=photo(), headers=JPEG).raise_for_status()
        found = client.post("/query?map=town", content=photo(), headers=JPEG)
    assert told == [("webhooks", found.json()["query"]["id"]), ("mqtt", found.json()["query"]["id"])]


@broker_needed
def test_a_service_that_is_killed_is_offline(tmp_path: Path) -> None:
    port = free_port()
    with broker(tmp_path, port), listening(port) as fleet:
        with RunningService(tmp_path / "data", REVISIT_MQTT=f"mqtt://127.0.0.1:{port}") as service:
            until(lambda: fleet.messages == [("revisit/status", b"online")])
            service.kill()
        until(lambda: fleet.messages[1:] == [("revisit/status", b"offline")])


@broker_needed
def test_what_was_found_while_the_broker_was_away_is_published_when_it_is_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(mqtt, "AGAIN_S", (1, 1))
    monkeypatch.setattr(mqtt, "WAITING", 20)  # as many as will wait
    port, outcomes = free_port(), list[str]()
    teller = Mqtt(f"mqtt://127.0.0.1:{port}", None, "revisit")
    teller.on_outcome(outcomes.append)
    connect, heard = teller._client.reconnect, threading.Event()

    def connect_once_somebody_listens() -> Any:
        if "cannot be reached" in caplog.text and not heard.is_set():
            raise ConnectionRefusedError
        return connect()

    monkeypatch.setattr(teller._client, "reconnect", connect_once_somebody_listens)
    with caplog.at_level(logging.INFO):
        teller.start()
        for number in range(20):
            teller.tell(answer(str(number)))
        until(lambda: "cannot be reached" in caplog.text)
        with broker(tmp_path, port), listening(port) as fleet:
            heard.set()
            until(lambda: len(outcomes) == 20)
            until(lambda: len(fleet.messages) >= 21)
            teller.close()
            until(lambda: fleet.messages[-1] == ("revisit/status", b"offline"))
    assert set(outcomes) == {"delivered"}
    assert [body for topic, body in fleet.messages if topic == "revisit/status"] == [b"online", b"offline"]
    found = {json.loads(body)["data"]["query"] for topic, body in fleet.messages if topic != "revisit/status"}
    assert found == {str(number) for number in range(20)}
    assert caplog.text.count("cannot be reached") == 1
    assert "is there again" in caplog.text


@contextmanager
def breaking(port: int) -> Iterator[tuple[int, list[tuple[socket.socket, socket.socket]]]]:
    """A port from which connections go on to `port`; both ends of each, which break one without the other."""
    ends: list[tuple[socket.socket, socket.socket]] = []
    threads: list[threading.Thread] = []

    def carry(one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(65536):
                other.sendall(data)

    def take() -> None:
        with suppress(OSError):
            while True:
                pair = taking.accept()[0], socket.create_connection(("127.0.0.1", port))
                ends.append(pair)
                for one, other in (pair, pair[::-1]):
                    threads.append(threading.Thread(target=carry, args=(one, other)))
                    threads[-1].start()

    with socket.create_server(("127.0.0.1", 0)) as taking:
        threads.append(threading.Thread(target=take))
        threads[0].start()
        yield taking.getsockname()[1], ends
        taking.shutdown(socket.SHUT_RDWR)
        threads[0].join()
        for end in (end for pair in ends for end in pair):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()
        for end in (end for pair in ends for end in pair):
            end.close()


@broker_needed
def test_a_service_whose_connection_broke_unseen_by_the_broker_stays_online(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a router's restart breaks it: the broker finds that out later than the service is back, and gave its will."""
    monkeypatch.setattr(mqtt, "KEEP_ALIVE_S", 2)
    port = free_port()
    with broker(tmp_path, port), breaking(port) as (between, ends):
        teller = Mqtt(f"mqtt://127.0.0.1:{between}", None, "revisit")
        with listening(port) as fleet:
            teller.start()
            until(lambda: fleet.messages == [("revisit/status", b"online")])
            ours, brokers = ends[0]
            ours.shutdown(socket.SHUT_RDWR)
            until(lambda: fleet.messages[1:].count(("revisit/status", b"online")))
            brokers.settimeout(PATIENCE_S)
            until(lambda: not brokers.recv(1, socket.MSG_PEEK))  # the broker has found out
        with listening(port) as late:
            until(lambda: late.messages)
        teller.close()
    assert late.messages == [("revisit/status", b"online")]


def test_a_broker_that_never_comes_delays_no_query_and_a_stop_by_seconds(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(mqtt, "WAITING", 50)
    teller, outcomes = Mqtt(f"mqtt://127.0.0.1:{free_port()}", None, "revisit"), list[str]()
    teller.on_outcome(outcomes.append)
    teller.start()
    began = time.monotonic()
    for number in range(200):
        teller.tell(answer(str(number)))
    assert outcomes == ["dropped"] * 150
    teller.close(0.5)
    assert time.monotonic() - began < PATIENCE_S / 4
    teller.tell(answer("late"))
    assert outcomes == ["dropped"] * 201
    assert "more than 50 wait" in caplog.text


def test_a_stop_does_not_wait_for_a_connection_that_is_being_made() -> None:
    """As where the network is away, or the names of hosts are not answered."""
    teller = Mqtt(f"mqtt://127.0.0.1:{free_port()}", None, "revisit")
    connecting, over = threading.Event(), threading.Event()

    def connect_without_end(client: Any, userdata: Any) -> None:
        connecting.set()
        over.wait()
        raise ConnectionRefusedError

    teller._client.on_pre_connect = connect_without_end
    teller.start()
    assert connecting.wait(PATIENCE_S)
    closing = threading.Thread(target=teller.close, args=(0.2,))
    closing.start()
    closing.join(PATIENCE_S / 4)
    waits = closing.is_alive()
    over.set()
    closing.join()
    assert not waits


@broker_needed
def test_a_wrong_password_is_said_once_and_never_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    port, attempts = free_port(), list[int]()
    monkeypatch.setattr(mqtt, "AGAIN_S", (1, 1))
    teller = Mqtt(f"mqtt://robot@127.0.0.1:{port}", "a guess", "revisit")
    teller._client.on_pre_connect = lambda client, userdata: attempts.append(1)
    with caplog.at_level(logging.INFO, "revisit"), broker(tmp_path, port, "let me in"):
        teller.start()
        until(lambda: len(attempts) >= 3)
        teller.close(0.1)
    (said,) = caplog.messages
    assert said == f"the broker of MQTT at 127.0.0.1:{port} refuses the connection: Not authorized"


@broker_needed
@pytest.mark.filterwarnings("ignore:unclosed <ssl:ResourceWarning")  # paho leaves the socket to its last reference
def test_a_certificate_that_is_not_trusted_is_told_as_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    port, outcomes, tls = free_port(), list[str](), self_signed(tmp_path)
    with broker(tmp_path, port, tls=tls):
        strange = Mqtt(f"mqtts://localhost:{port}", None, "revisit")
        strange.start()
        until(lambda: caplog.messages)
        strange.close(0.1)
        monkeypatch.setenv("SSL_CERT_FILE", str(tls[1]))
        known = Mqtt(f"mqtts://localhost:{port}", None, "revisit")
        known.on_outcome(outcomes.append)
        known.start()
        known.tell(answer("q"))
        until(lambda: outcomes == ["delivered"])
        known.close()
    assert caplog.messages == [
        f"the broker of MQTT at localhost:{port} shows a certificate that is not trusted (self-signed certificate);"
        " events wait"
    ]


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("REVISIT_MQTT", "broker.example"),
        ("REVISIT_MQTT", "mqtt://robot:secret@broker.example"),
        ("REVISIT_MQTT", "http://broker.example"),
        ("REVISIT_MQTT", "mqtt://broker..example"),
        ("REVISIT_MQTT", f"mqtt://{'a' * 64}.example"),
        ("REVISIT_MQTT", "mqtt://."),
        ("REVISIT_MQTT", "mqtt://broker.example:70000"),
        ("REVISIT_MQTT", "mqtt://broker.example:0"),
        ("REVISIT_MQTT_TOPIC", "all/#"),
        ("REVISIT_MQTT_TOPIC", "/revisit"),
        ("REVISIT_MQTT_TOPIC", ""),
    ],
)
def test_settings_that_cannot_be_used_are_named(setting: str, value: str) -> None:
    with pytest.raises(SetupError, match=setting):
        read_settings({setting: value})


def test_a_service_without_the_package_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "paho.mqtt.client", None)
    with pytest.raises(SetupError, match="pip install paho-mqtt"):
        Mqtt("mqtt://127.0.0.1", None, "revisit")
