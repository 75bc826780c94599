"""The example configurations of nginx, run: large bodies, one form of refusals, kept connections, a dead node."""

import io
import json
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from app.http.problems import KINDS
from schemas.wire import Problem
from tests.sample_images import photo
from tests.stories.raw import Answer, answers, read_all
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("a proxy speaks HTTP")

INCLUDED = "/etc/nginx/revisit-problems.conf"
DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
JPEG, PNG = {"content-type": "image/jpeg"}, {"content-type": "image/png"}
PASSWORD = ("robot", "secret")


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def nginx(folder: Path, inside: str, port: int) -> Iterator[str]:
    """Nginx with these lines in its `http` block, until it listens on a port; its address."""
    program = shutil.which("nginx")
    if program is None:
        pytest.skip("NO PROXY IS TRIED: nginx is not installed (Debian: apt-get install nginx-light)")
    folder.mkdir()
    (folder / "problems.conf").write_text((DEPLOY / "nginx-problems.conf").read_text())
    assert INCLUDED in inside
    inside = inside.replace(INCLUDED, str(folder / "problems.conf"))
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    temporary = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in kinds)
    (folder / "passwords").write_text(":{PLAIN}".join(PASSWORD))
    (folder / "nginx.conf").write_text(
        f"daemon off;\nuser root;\npid {folder}/pid;\nerror_log {folder}/errors;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{temporary}{inside}\n}}\n"
    )
    running = subprocess.Popen([program, "-c", str(folder / "nginx.conf"), "-e", str(folder / "errors")])
    try:
        for _ in range(200):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert running.poll() is None, (folder / "errors").read_text()
            time.sleep(0.05)
        yield f"http://127.0.0.1:{port}"
    finally:
        running.terminate()
        running.wait()


@contextmanager
def proxy(folder: Path, service_url: str, rate: int = 1000, read_s: int = 130) -> Iterator[httpx.Client]:
    """A client of deploy/nginx.conf in front of a service, with what its head says stands beside the server block."""
    text = (DEPLOY / "nginx.conf").read_text()
    around = re.findall(r"^#   (.*)$", text, re.MULTILINE)
    assert around[0] == "limit_req_zone $binary_remote_addr zone=revisit:10m rate=10r/s;"
    outside = "\n".join(around).replace("127.0.0.1:8000", service_url.removeprefix("http://"))
    inside = text.replace("/etc/nginx/revisit.passwords", str(folder / "passwords"))
    assert "proxy_read_timeout 130s;" in inside
    inside = inside.replace("proxy_read_timeout 130s;", f"proxy_read_timeout {read_s}s;")
    port = free_port()
    server = f"server {{\nlisten 127.0.0.1:{port};\n{inside}\n}}"
    with (
        nginx(folder, outside.replace("rate=10r/s", f"rate={rate}r/s") + "\n" + server, port) as url,
        httpx.Client(base_url=url, auth=PASSWORD, timeout=60) as client,
    ):
        yield client


def check(answer: httpx.Response, status: int, code: str) -> None:
    """A whole problem, whoever wrote it."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    told = answer.json()
    assert (told["type"], told["status"]) == (f"urn:revisit:problem:{code}", status)
    assert {"title", "detail", "errors"} <= told.keys()
    assert told["request_id"] == answer.headers["x-request-id"]


def by_hand(client: httpx.Client, sent: bytes) -> Answer:
    """The answer to bytes that no library would send."""
    with socket.create_connection(("127.0.0.1", client.base_url.port or 80), 20) as connection:
        connection.sendall(sent)
        (answer,) = answers(read_all(connection))
    return answer


REFUSED = {
    "a line that is no request": (b"nonsense\r\n\r\n", 400, "bad-request"),
    "no Host": (b"GET /maps HTTP/1.1\r\n\r\n", 400, "bad-request"),
    "another version": (b"GET /maps HTTP/4.0\r\nHost: a\r\n\r\n", 400, "bad-request"),
    "a length that is no number": (b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: x\r\n\r\n", 400, "bad-request"),
    "an unknown encoding": (b"POST /query HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: gzip\r\n\r\n", 400, "bad-request"),
    "a method that is not passed on": (
        b"TRACE /maps HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n",
        405,
        "method-not-allowed",
    ),
    "an address of its own": (
        b"GET /nginx-problem/forbidden HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n",
        404,
        "not-found",
    ),
    "a long address": (b"GET /" + b"a" * 40_000 + b" HTTP/1.1\r\nHost: a\r\n\r\n", 431, "headers-too-large"),
    "a long header": (b"GET / HTTP/1.1\r\nHost: a\r\nX-A: " + b"a" * 40_000 + b"\r\n\r\n", 431, "headers-too-large"),
}


def test_each_refusal_of_the_proxy_is_one_that_the_service_knows() -> None:
    text = (DEPLOY / "nginx-problems.conf").read_text()
    written = re.findall(r"return (\d+) '(.*)';", text)
    assert len(written) == text.count("error_page ") > 5
    for status, body in written:
        told = json.loads(body)
        kind = KINDS[told["type"].removeprefix("urn:revisit:problem:")]
        assert (int(status), told["status"], told["title"]) == (kind.status, kind.status, kind.title)
        assert Problem.model_validate(told).detail


class Slow(BaseHTTPRequestHandler):
    """Answers once it has worked for a while, as a restoration does."""

    def do_POST(self) -> None:
        """Answer late."""
        self.rfile.read(int(self.headers["content-length"]))
        time.sleep(2.5)
        self.send_response(201)
        self.send_header("content-length", "0")
        self.end_headers()


def test_a_restoration_or_an_import_may_work_for_longer_than_a_query(tmp_path: Path) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Slow) as slow:
        threading.Thread(target=slow.serve_forever, daemon=True).start()
        with proxy(tmp_path / "nginx", f"http://127.0.0.1:{slow.server_port}", read_s=1) as client:
            told = [client.post(path, content=b"x").status_code for path in ("/restore", "/maps/m/imports", "/query")]
        slow.shutdown()
    assert told == [201, 201, 503]


def noise(side: int) -> bytes:
    """A PNG that cannot be packed: about three bytes a pixel."""
    pixels = np.random.default_rng(side).integers(0, 256, (side, side, 3), np.uint8)
    return bytes(cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


@pytest.mark.slow
def test_bodies_up_to_the_limit_go_through_and_all_refusals_have_one_form(tmp_path: Path) -> None:
    with RunningService(tmp_path / "data") as service, proxy(tmp_path / "nginx", service.url, read_s=5) as client:
        largest = noise(2880)
        assert 24_800_000 < len(largest) < 25_000_000
        assert client.post("/enroll", content=largest, headers=PNG).status_code == 201
        check(client.post("/enroll", content=largest + bytes(500_000), headers=PNG), 413, "body-too-large")
        check(client.post("/enroll", content=bytes(40_000_000), headers=PNG), 413, "body-too-large")
        chunks = (bytes(1_000_000) for _ in range(40))
        check(client.post("/enroll", content=chunks, headers=PNG), 413, "body-too-large")
        # Recordings and snapshots may be larger; the service says what is wrong with this one.
        refused = client.post("/restore", content=bytes(40_000_000), headers={"content-type": "application/zip"})
        check(refused, 400, "malformed-body")
        check(client.get("/views/unknown"), 404, "not-found")

        refused = client.get("/views", auth=None)
        check(refused, 401, "unauthorized")
        assert refused.headers["www-authenticate"] == 'Basic realm="revisit"'
        assert client.get("/readyz", auth=None).json()["ready"]

        for name, (sent, status, code) in REFUSED.items():
            told = by_hand(client, sent)
            assert (told.status, told.problem()) == (status, code), name
        service.signal(signal.SIGSTOP)
        check(client.get("/maps"), 503, "unavailable")  # it does not answer in time: nginx's 504
        service.signal(signal.SIGCONT)
        service.kill()
        away = client.post("/query", content=photo(), headers=JPEG)
        check(away, 503, "unavailable")
        assert int(away.headers["retry-after"]) > 0


def test_too_many_requests_are_refused_by_the_proxy_as_the_service_would(tmp_path: Path) -> None:
    with RunningService(tmp_path / "data") as service, proxy(tmp_path / "nginx", service.url, rate=1) as client:
        answers = [client.get("/maps") for _ in range(60)]
        assert answers[0].status_code == 200
        check(answers[-1], 429, "too-many-requests")
        assert int(answers[-1].headers["retry-after"]) > 0


def test_callers_do_not_choose_the_address_by_which_they_are_counted(tmp_path: Path) -> None:
    with (
        RunningService(tmp_path / "data", REVISIT_LIMIT_REQUESTS="5") as service,
        proxy(tmp_path / "nginx", service.url) as client,
    ):
        said = [{"x-forwarded-for": f"192.0.2.{number}"} for number in range(7)]
        statuses = [client.get("/maps", headers=headers).status_code for headers in said]
        assert statuses == [200] * 5 + [429] * 2


@pytest.mark.slow
def test_connections_are_kept_on_both_sides_and_never_used_after_the_service_closed_them(tmp_path: Path) -> None:
    """The service ends a connection that is silent for 5 s; an enrolment on such a one would be lost as a 502."""
    with RunningService(tmp_path / "data") as service, proxy(tmp_path / "nginx", service.url) as client:
        body = photo()
        assert client.post("/enroll", content=body, headers=JPEG).status_code == 201
        for pause in (0, 0, 3.9, 4.0, 4.9, 5.0, 5.1):
            time.sleep(pause)
            assert client.post("/query", content=body, headers=JPEG).status_code == 200
        ids = {client.get("/maps").headers["x-request-id"] for _ in range(20)}
        assert len(ids) == 20
        assert connections_to(service.url) <= 2


def connections_to(url: str) -> int:
    """Connections to a port of this machine, by its table."""
    port = f":{int(url.rpartition(':')[2]):04X}"
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return sum(row[2].endswith(port) and row[3] == "01" for row in rows)


@pytest.mark.slow
def test_a_snapshot_is_streamed_through(tmp_path: Path) -> None:
    with RunningService(tmp_path / "data") as service, proxy(tmp_path / "nginx", service.url) as client:
        client.post("/enroll?map=m", content=noise(1200), headers=PNG)
        job = client.post("/maps/m/snapshots").json()["id"]
        while (told := client.get(f"/jobs/{job}").json())["state"] != "done":
            assert told["state"] in ("waiting", "running"), told
            time.sleep(0.1)
        got = io.BytesIO()
        with client.stream("GET", f"/snapshots/{told['result']['snapshot']}") as answer:
            assert answer.status_code == 200
            for part in answer.iter_bytes():
                got.write(part)
        assert len(got.getvalue()) == told["result"]["bytes"] > 4_000_000
        wanted = {"range": "bytes=4000000-", "if-range": answer.headers["etag"]}
        rest = client.get(f"/snapshots/{told['result']['snapshot']}", headers=wanted)
        assert (rest.status_code, rest.content == got.getvalue()[4_000_000:]) == (206, True)
        again = client.post("/restore?as=n", content=got.getvalue(), headers={"content-type": "application/zip"})
        assert again.status_code == 201, again.text


@pytest.mark.slow
def test_callers_of_a_fleet_do_not_notice_a_node_that_is_gone(tmp_path: Path) -> None:
    port = free_port()
    with RunningService(tmp_path / "a") as one, RunningService(tmp_path / "b") as other:
        text = (DEPLOY / "fleet" / "nginx.conf").read_text().replace("listen 8000", f"listen 127.0.0.1:{port}")
        for name, node in (("node-a:8000", one), ("node-b:8000", other)):
            assert name in text
            text = text.replace(name, node.url.removeprefix("http://"))
        with nginx(tmp_path / "nginx", text, port) as url, httpx.Client(base_url=url, timeout=60) as client:
            assert client.post("/enroll", content=photo(), headers=JPEG).status_code == 201
            mine = next(node for node in (one, other) if httpx.get(f"{node.url}/maps").json()["maps"])
            assert len({client.get("/maps").text for _ in range(5)}) == 1, "a caller stays with one node"
            mine.kill()
            assert client.post("/query?map=default", content=photo(), headers=JPEG).status_code in (200, 404)
            assert client.get("/readyz").json()["ready"]
            check(client.post("/enroll", content=bytes(40_000_000), headers=PNG), 413, "body-too-large")
            assert by_hand(client, REFUSED["a line that is no request"][0]).problem() == "bad-request"
            (other if mine is one else one).kill()
            check(client.get("/maps"), 503, "unavailable")
