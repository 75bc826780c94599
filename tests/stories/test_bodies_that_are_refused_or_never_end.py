"""A caller sees why its body was refused, while it still sends; one that never ends does not hold a connection."""

import http.client
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.raw import answers, connect, read_all, read_one, say
from tests.stories.running import RunningService
from tests.waiting import until

pytestmark = pytest.mark.one_database("such requests never reach the database")

TOO_LARGE = b"x" * 3_000_000
HEAD_S, BODY_S = 1, 2


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    limits = {"REVISIT_MAX_BODY_MB": "1", "REVISIT_BODY_S": str(BODY_S), "REVISIT_HEAD_S": str(HEAD_S)}
    with RunningService(tmp_path_factory.mktemp("edge"), **limits) as service:
        yield service


@pytest.mark.parametrize("chunked", [False, True], ids=["content-length", "chunked"])
def test_httpx_sees_the_refusal(service: RunningService, chunked: bool) -> None:
    body = (TOO_LARGE[i : i + 10_000] for i in range(0, len(TOO_LARGE), 10_000)) if chunked else TOO_LARGE
    answer = httpx.post(f"{service.url}/enroll", content=body, headers={"content-type": "image/jpeg"}, timeout=60)
    assert (answer.status_code, answer.json()["type"]) == (413, "urn:revisit:problem:body-too-large")
    assert answer.headers["connection"] == "close"


@pytest.mark.parametrize("chunked", [False, True], ids=["content-length", "chunked"])
def test_the_standard_library_sees_the_refusal(service: RunningService, chunked: bool) -> None:
    connection = http.client.HTTPConnection(urlsplit(service.url).netloc, timeout=20)
    body = iter([TOO_LARGE[:1_500_000], TOO_LARGE[1_500_000:]]) if chunked else TOO_LARGE
    headers = {"content-type": "image/jpeg"} | ({"transfer-encoding": "chunked"} if chunked else {})
    connection.request("POST", "/enroll", body, headers, encode_chunked=chunked)
    answer = connection.getresponse()
    assert answer.status == 413
    assert b"body-too-large" in answer.read()
    connection.close()


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
@pytest.mark.parametrize(
    "header",
    ["Expect:", "Expect: 100-continue", "Transfer-Encoding: chunked"],
    ids=["content-length", "expect", "chunked"],
)
def test_curl_sees_the_refusal(service: RunningService, tmp_path: Path, header: str) -> None:
    image = tmp_path / "large.jpg"
    image.write_bytes(TOO_LARGE)
    command = ["curl", "-sS", "-w", "\n%{http_code}", "-H", header, "-H", "content-type: image/jpeg"]
    run = subprocess.run(
        [*command, "--data-binary", f"@{image}", f"{service.url}/enroll"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert "body-too-large" in run.stdout
    assert run.stdout.endswith("413")


def test_whoever_asks_first_is_refused_before_it_sends(service: RunningService) -> None:
    with connect(service) as connection:
        connection.sendall(
            b"POST /enroll HTTP/1.1\r\nHost: a\r\nContent-Length: 3000000\r\nExpect: 100-continue\r\n\r\n"
        )
        (answer,) = answers(read_all(connection))
    assert (answer.status, answer.problem()) == (413, "body-too-large")


def test_a_body_far_beyond_the_limit_is_not_read_for_ever(service: RunningService) -> None:
    """Four times the limit are thrown away; then the connection is broken."""
    with connect(service) as connection:
        connection.sendall(b"POST /enroll HTTP/1.1\r\nHost: a\r\nContent-Length: 10000000000\r\n\r\n")
        with pytest.raises(OSError, match=r"reset|pipe"):
            send_repeatedly(connection, TOO_LARGE, 30)


def send_repeatedly(connection: socket.socket, data: bytes, times: int, pause_s: float = 0) -> None:
    for _ in range(times):
        connection.sendall(data)
        threading.Event().wait(pause_s)


def trickle(connection: socket.socket, data: bytes, pause_s: float, stop: threading.Event) -> None:
    while not stop.wait(pause_s):
        try:
            connection.sendall(data)
        except OSError:
            return


@pytest.mark.parametrize(
    "head",
    [b"Content-Length: 1000", b"Transfer-Encoding: chunked"],
    ids=["content-length", "chunked"],
)
@pytest.mark.parametrize("trickles", [False, True], ids=["silent", "trickle"])
def test_a_body_that_does_not_end_is_answered_and_closed(service: RunningService, head: bytes, trickles: bool) -> None:
    begin, stop = time.monotonic(), threading.Event()
    with connect(service) as connection:
        connection.sendall(b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\n" + head + b"\r\n\r\n")
        piece = b"1\r\nx\r\n" if b"chunked" in head else b"x"
        sender = threading.Thread(target=trickle, args=(connection, piece, 0.1, stop))
        if trickles:
            sender.start()
        try:
            (answer,) = answers(read_all(connection))
        finally:
            stop.set()
            if trickles:
                sender.join()
    assert (answer.status, answer.problem()) == (408, "request-timeout")
    assert answer.headers["connection"] == "close"
    assert BODY_S <= time.monotonic() - begin < BODY_S + 5


def test_what_is_still_sent_after_the_answer_does_not_hold_the_connection(service: RunningService) -> None:
    """The rest of a refused body trickles in: it is thrown away for a while, then the connection is closed."""
    begin = time.monotonic()
    with connect(service) as connection:
        connection.sendall(b"POST /enroll HTTP/1.1\r\nHost: a\r\nContent-Length: 3000000\r\n\r\n")
        (answer,) = answers(read_all(connection))
        assert answer.problem() == "body-too-large"
        with pytest.raises(OSError, match=r"reset|pipe"):
            send_repeatedly(connection, b"x", 300, 0.1)
    assert time.monotonic() - begin < BODY_S + 5


@pytest.mark.parametrize("begun", [b"GET /livez HTTP/1.1\r\nHost: a\r\n", b"G", b"GET /livez HTTP/1.1\r\nX-A: b"])
def test_headers_that_do_not_end_are_answered_and_closed(service: RunningService, begun: bytes) -> None:
    begin, stop = time.monotonic(), threading.Event()
    with connect(service) as connection:
        connection.sendall(begun)
        sender = threading.Thread(target=trickle, args=(connection, b"x", 0.2, stop))
        sender.start()
        try:
            (answer,) = answers(read_all(connection))
        finally:
            stop.set()
            sender.join()
    assert (answer.status, answer.problem()) == (408, "request-timeout")
    assert HEAD_S <= time.monotonic() - begin < HEAD_S + 5


def test_the_second_request_of_a_connection_has_the_same_time(service: RunningService) -> None:
    with connect(service) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\nHost: a\r\n\r\n")
        assert read_one(connection).status == 200
        connection.sendall(b"GET /livez HT")
        (answer,) = answers(read_all(connection))
    assert (answer.status, answer.problem()) == (408, "request-timeout")


def test_a_connection_that_says_nothing_is_closed(service: RunningService) -> None:
    with connect(service) as connection:
        assert read_all(connection) == b""
    assert [answer.status for answer in say(service, b"GET /livez HTTP/1.1\r\nHost: a\r\n\r\n")] == [200]


def test_headers_that_are_too_long_are_a_problem(service: RunningService) -> None:
    for head in (b"X-A: " + b"a" * 70_000, b"X-A: b\r\n" * 20_000, b"Cookie: " + b"a" * 1_000_000):
        (answer,) = say(service, b"GET /livez HTTP/1.1\r\nHost: a\r\n" + head + b"\r\n\r\n")
        assert (answer.status, answer.problem()) == (431, "headers-too-large")
    (answer,) = say(service, b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\nHost: a\r\n\r\n")
    assert (answer.status, answer.problem()) == (431, "headers-too-large")


def test_beyond_the_bound_on_connections_callers_are_told(tmp_path: Path) -> None:
    with RunningService(tmp_path, REVISIT_CONNECTIONS="4") as service:
        held = [connect(service) for _ in range(4)]
        for connection in held:
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: a\r\n\r\n")
            assert read_one(connection).status == 200
        (answer,) = say(service, b"GET /maps HTTP/1.1\r\nHost: a\r\n\r\n")
        assert (answer.status, answer.problem(), answer.headers["connection"]) == (503, "unavailable", "close")
        assert int(answer.headers["retry-after"]) > 0
        (probe,) = say(service, b"GET /livez HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
        assert probe.status == 200
        for connection in held:
            connection.close()
        assert httpx.get(f"{service.url}/maps").status_code == 200


def test_connections_that_stop_before_the_end_keep_nobody_out(tmp_path: Path) -> None:
    """What they sent fills the memory for bodies; who comes next is put off for seconds, not for minutes."""
    begun = b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\nContent-Length: 1000000\r\n\r\n"
    with RunningService(tmp_path, REVISIT_MAX_BODY_MB="1", REVISIT_BODIES_MB="4") as service, ExitStack() as stack:

        def enrolled() -> httpx.Response:
            body = photo() + bytes(100_000)
            return httpx.post(f"{service.url}/enroll", content=body, headers={"content-type": "image/jpeg"}, timeout=60)

        def refused() -> tuple[socket.socket, httpx.Response] | None:
            """One of the connections that fill the memory, and the answer to who comes next."""
            held = [stack.enter_context(connect(service, 60)) for _ in range(4)]
            for connection in held:
                connection.sendall(begun + b"x" * 999_000)
            threading.Event().wait(0.5)
            answer = enrolled()
            if answer.status_code == 429:
                return held[0], answer
            stack.close()  # the photo was there before the last of them
            return None

        oldest, answer = until(refused)
        assert answer.json()["type"] == "urn:revisit:problem:too-many-requests"
        assert 'revisit_rejected_total{reason="memory"}' in httpx.get(f"{service.url}/metrics").text
        assert int(answer.headers["retry-after"]) > 0
        until(lambda: enrolled().status_code in (200, 201))
        (given_up,) = answers(read_all(oldest))
        assert (given_up.status, given_up.problem()) == (408, "request-timeout")
        assert b"others needed its memory" in given_up.body
