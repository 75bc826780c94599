"""Webhooks: an app is told what a robot recognised, by messages that are signed, repeated and never delay a query."""

import base64
import functools
import hashlib
import hmac
import json
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.http import webhooks
from app.http.examples import QUERY_ANSWER
from app.http.webhooks import Webhooks, signature
from schemas.errors import SetupError
from schemas.settings import read_settings
from schemas.wire import QueryAnswer
from tests.certificates import self_signed
from tests.sample_images import photo
from tests.stories.running import RunningService
from tests.waiting import PATIENCE_S, until

JPEG = {"content-type": "image/jpeg"}
apart = pytest.mark.one_database("events leave the memory of a service, and no row is read")
SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
SOON = (0.05, 0.05)
EVERYTHING = ("matched", "no_match", "look-alike")


@dataclass
class Receiver:
    """An app that is told; `statuses` are its first answers, then it answers 204."""

    url: str
    statuses: list[int] = field(default_factory=list)
    messages: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    callers: set[int] = field(default_factory=set)
    """Ports that connections came from."""

    def bodies(self, count: int) -> list[dict[str, Any]]:
        """The first messages, once so many have come."""
        until(lambda: len(self.messages) >= count)
        return [json.loads(body) for _, body in self.messages]


@contextmanager
def answering(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    """The address of a receiver."""
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/hook"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def receiving(*statuses: int) -> Iterator[Receiver]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            got.callers.add(self.client_address[1])
            body = self.rfile.read(int(self.headers["content-length"]))
            got.messages.append(({name.lower(): value for name, value in self.headers.items()}, body))
            self.send_response(got.statuses.pop(0) if got.statuses else 204)
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    with answering(Handler) as url:
        got = Receiver(url, list(statuses))
        yield got


def answer(query: str = "q1", **changes: Any) -> QueryAnswer:
    return QueryAnswer.model_validate({**QUERY_ANSWER, "query": {**QUERY_ANSWER["query"], "id": query}, **changes})


def look_alike(query: str) -> QueryAnswer:
    view = QUERY_ANSWER["matches"][0]["view"]
    rival = {"view": {**view, "id": "r1", "map": "floor2", "place": "lift"}, "score": 0.5, "differs": None}
    reason = {"code": "look-alike", "detail": "as good", "remedy": "look", "rival": rival}
    return answer(query, status="ambiguous", reason=reason)


@contextmanager
def telling(
    url: str, kinds: tuple[str, ...] = ("matched", "no_match", "look-alike")
) -> Iterator[tuple[Webhooks, list[str]]]:
    made, outcomes = Webhooks(url, SECRET, kinds, SOON), list[str]()
    made.on_outcome(outcomes.append)
    made.start()
    try:
        yield made, outcomes
    finally:
        made.close()


def settled(outcomes: list[str], count: int) -> list[str]:
    until(lambda: len(outcomes) >= count)
    return outcomes


@apart
def test_the_signature_is_that_of_the_standard() -> None:
    """The example of the specification's own libraries."""
    said = signature(SECRET, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert said == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_a_query_is_told_and_can_be_verified(tmp_path: Path) -> None:
    with (
        receiving() as app,
        RunningService(tmp_path, REVISIT_WEBHOOK=app.url, REVISIT_WEBHOOK_SECRET=SECRET) as service,
        httpx.Client(base_url=service.url, timeout=30) as client,
    ):
        assert client.post("/enroll?map=town&place=gate", content=photo(), headers=JPEG).status_code == 201
        found = client.post("/query?map=town", content=photo(), headers=JPEG).json()
        assert client.get("/metrics").status_code == 200
        [body] = app.bodies(1)
        until(lambda: 'revisit_webhooks_total{outcome="delivered"} 1.0' in client.get("/metrics").text)
        assert service.stop() == 0
    assert body["type"] == f"query.{'look-alike' if found['reason']['code'] == 'look-alike' else found['status']}"
    told = body["data"]
    assert (told["query"], told["map"], told["status"]) == (found["query"]["id"], "town", found["status"])
    assert (told["place"], told["view"]) == ("gate", found["matches"][0]["view"]["id"])
    headers, raw = app.messages[0]
    assert headers["webhook-id"] == found["query"]["id"]
    assert abs(int(headers["webhook-timestamp"]) - time.time()) < 60
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + raw
    key = base64.b64decode(SECRET.removeprefix("whsec_"))
    digest = base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()
    assert headers["webhook-signature"] == f"v1,{digest}"
    assert SECRET not in "".join(service.output)


@apart
def test_only_what_is_wanted_is_told() -> None:
    with receiving() as app, telling(app.url, ("look-alike",)) as (hooks, _):
        hooks.tell(answer("a"))
        hooks.tell(answer("b", status="no_match"))
        hooks.tell(answer("c", status="ambiguous", reason={"code": "weak", "detail": "", "remedy": "", "rival": None}))
        hooks.tell(look_alike("d"))
        [told] = app.bodies(1)
    assert told["type"] == "query.look-alike"
    assert told["data"]["rival"] == {"map": "floor2", "place": "lift", "view": "r1"}


@apart
def test_what_is_not_taken_is_sent_again_and_holds_up_nothing_else() -> None:
    with receiving(503, 429) as app, telling(app.url) as (hooks, outcomes):
        hooks.tell(answer("first"))
        hooks.tell(answer("second"))
        assert settled(outcomes, 2) == ["delivered", "delivered"]
        ids = [headers["webhook-id"] for headers, _ in app.messages]
    assert sorted(ids) == ["first", "first", "second", "second"]
    bodies: dict[str, set[bytes]] = {headers["webhook-id"]: set() for headers, _ in app.messages}
    for headers, body in app.messages:
        bodies[headers["webhook-id"]].add(body)
    assert [len(of) for of in bodies.values()] == [1, 1]  # the same message each time


@apart
def test_events_that_follow_each_other_go_by_one_connection() -> None:
    """Over TLS to another continent a new one for each takes three times as long."""
    with receiving() as app, telling(app.url) as (hooks, outcomes):
        for number in range(20):
            hooks.tell(answer(f"q{number}"))
        assert settled(outcomes, 20) == ["delivered"] * 20
        assert len(app.callers) == 1


@apart
def test_an_answer_whose_body_is_late_is_taken_and_the_next_event_goes_by_another_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(webhooks, "BODY_S", 0.1)
    callers: set[int] = set()

    class Late(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            callers.add(self.client_address[1])
            self.rfile.read(int(self.headers["content-length"]))
            self.send_response(200)
            self.send_header("content-length", "2")
            self.end_headers()
            self.connection.recv(1)  # until the other side gives up

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    with answering(Late) as url, telling(url) as (hooks, outcomes):
        hooks.tell(answer("q1"))
        hooks.tell(answer("q2"))
        assert settled(outcomes, 2) == ["delivered"] * 2
    assert len(callers) == 2


@apart
def test_an_answer_that_never_ends_holds_nothing_up() -> None:
    ended = threading.Event()

    class Endless(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["content-length"]))
            self.send_response(200)
            self.end_headers()
            with suppress(OSError):
                while not ended.wait(0.01):
                    self.wfile.write(b"more and " * 100)

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    with answering(Endless) as url:
        try:
            with telling(url) as (webhooks, outcomes):
                for number in range(3):
                    webhooks.tell(answer(f"q{number}"))
                assert settled(outcomes, 3) == ["delivered"] * 3
        finally:
            ended.set()


@pytest.fixture(params=["http", "https"])
def dripping(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[str, list[socket.socket]]]:
    """Address of a receiver whose headers never end, a byte every hundredth of a second, and its connections."""
    ended, taken, threads = threading.Event(), list[socket.socket](), list[threading.Thread]()
    wrap: Callable[[socket.socket], socket.socket] = lambda connection: connection  # noqa: E731
    if request.param == "https":
        key, certificate = self_signed(tmp_path)
        monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key)
        wrap = functools.partial(context.wrap_socket, server_side=True)

    def drip(connection: socket.socket) -> None:
        with suppress(OSError), wrap(connection) as speaking:
            speaking.recv(65536)
            speaking.sendall(b"HTTP/1.1 204 No Content\r\nX-Long: ")
            while not ended.wait(0.01):
                speaking.sendall(b"a")

    def take() -> None:
        with suppress(OSError):
            while True:
                taken.append(listening.accept()[0])
                threads.append(threading.Thread(target=drip, args=(taken[-1],)))
                threads[-1].start()

    with socket.create_server(("localhost", 0)) as listening:
        threads.append(threading.Thread(target=take))
        threads[0].start()
        yield f"{request.param}://localhost:{listening.getsockname()[1]}/hook", taken
        ended.set()
        listening.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()


@apart
def test_headers_that_drip_and_never_end_are_broken_off_and_the_next_event_is_tried(
    dripping: tuple[str, list[socket.socket]], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    url, taken = dripping
    monkeypatch.setattr(webhooks, "TIMEOUT_S", 0.3)
    began = time.monotonic()
    with telling(url) as (hooks, outcomes):
        hooks.tell(answer("first"))
        hooks.tell(answer("second"))
        assert settled(outcomes, 2) == ["given_up", "given_up"]
    assert time.monotonic() - began >= 6 * 0.3
    until(lambda: len(taken) >= 6)
    assert len(taken) == 6, "each attempt has a connection of its own, since the one before was broken off"
    assert "webhook first is lost: no whole answer in time after attempt 3" in caplog.text


@apart
def test_a_stop_does_not_wait_for_headers_that_drip(
    dripping: tuple[str, list[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    url, taken = dripping
    monkeypatch.setattr(webhooks, "TIMEOUT_S", 10 * PATIENCE_S)  # that of an attempt, were it waited for
    hooks = Webhooks(url, None, ("matched",))
    outcomes: list[str] = []
    hooks.on_outcome(outcomes.append)
    hooks.start()
    hooks.tell(answer("late"))
    until(lambda: taken)
    hooks.close(0.5)
    until(lambda: outcomes)
    assert outcomes == ["given_up"]


@apart
@pytest.mark.parametrize(
    ("statuses", "outcome", "attempts"), [((410,), "refused", 1), ((302,), "refused", 1), ((500,) * 3, "given_up", 3)]
)
def test_what_is_refused_or_never_taken_is_said(
    statuses: tuple[int, ...], outcome: str, attempts: int, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), receiving(*statuses) as app, telling(app.url) as (hooks, outcomes):
        hooks.tell(answer("lost"))
        assert settled(outcomes, 1) == [outcome]
        assert len(app.messages) == attempts
    assert f"webhook lost is lost: answered {statuses[-1]} to attempt {attempts}" in caplog.text
    assert ("a redirect, which is not followed" in caplog.text) == (statuses == (302,))


@apart
def test_a_receiver_that_is_away_delays_no_query_and_a_stop_by_seconds(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(webhooks, "WAITING", 50)
    hooks = Webhooks("http://127.0.0.1:9/", None, ("matched",))  # nobody listens there
    outcomes: list[str] = []
    hooks.on_outcome(outcomes.append)
    hooks.start()
    began = time.monotonic()
    for number in range(200):
        hooks.tell(answer(str(number)))
    hooks.close(1)
    assert time.monotonic() - began < webhooks.DELAYS_S[1] / 2, "an attempt that comes again later was waited for"
    hooks.tell(answer("late"))
    assert 195 <= len(outcomes) <= 200  # one may be on its way
    assert set(outcomes) <= {"dropped", "given_up"}
    assert "more than 50 wait" in caplog.text


@apart
@pytest.mark.parametrize("url", ["http://a..b/hook", "http://xn--/hook", "http://\u202e/hook", "http://[::1/hook"])
def test_an_address_that_cannot_be_one_is_given_up_and_the_next_event_is_tried(url: str) -> None:
    """Settings refuse most of these; none of them may end the thread that sends."""
    with telling(url) as (webhooks, outcomes):
        for number in range(2):
            webhooks.tell(answer(f"q{number}"))
        assert settled(outcomes, 2) == ["given_up", "given_up"]


@apart
@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("REVISIT_WEBHOOK", "app.example/hook"),
        ("REVISIT_WEBHOOK", "https://key@app.example/hook"),
        ("REVISIT_WEBHOOK", "http://app..example/hook"),
        ("REVISIT_WEBHOOK", f"http://{'a' * 64}.example/hook"),
        ("REVISIT_WEBHOOK", "http://[::1/hook"),
        ("REVISIT_WEBHOOK", "http://app.example:port/hook"),
        ("REVISIT_WEBHOOK", "http://app.example:70000/hook"),
        ("REVISIT_WEBHOOK", "http://app.example:0/hook"),
        ("REVISIT_WEBHOOK_SECRET", "whsec_not base64 at all"),
        ("REVISIT_WEBHOOK_SECRET", "too-short"),
        ("REVISIT_WEBHOOK_EVENTS", "matched,found"),
        ("REVISIT_WEBHOOK_EVENTS", ","),
    ],
)
def test_settings_that_cannot_be_used_are_named_and_secrets_are_not_told(setting: str, value: str) -> None:
    with pytest.raises(SetupError, match=setting) as refused:
        read_settings({setting: value})
    assert ("SECRET" not in setting) or value not in str(refused.value)
