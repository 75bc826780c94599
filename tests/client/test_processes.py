"""The client in programs with several processes, behind proxies, and with odd names."""

import copy
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from revisit_client import ClientError, JobFailed, Revisit, RevisitProblem, Unreachable, Unsendable, wire

from tests import answers
from tests.client.test_client import Clock, client, refused
from tests.client.test_repetition import in_turn
from tests.stories.running import ROOT

FORKED = """
import os
from revisit_client import Revisit

revisit = Revisit(os.environ["SERVICE"])
revisit.maps()
child = os.fork()
revisit.maps()
if child:
    assert os.waitpid(child, 0)[1] == 0
os._exit(0)
"""


@pytest.fixture
def callers() -> Iterator[tuple[str, list[int]]]:
    """A service that keeps connections open, and the port of the caller of each request."""
    ports: list[int] = []

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            ports.append(self.client_address[1])
            if len(ports) > 1:
                time.sleep(0.5)  # so that the calls of two processes overlap
            data = b'{"maps": []}'
            self.send_response(200)
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", ports
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_forked_process_has_connections_of_its_own(callers: tuple[str, list[int]]) -> None:
    """On a shared one each would read what the other was answered: another photo's place."""
    url, ports = callers
    path = f"{ROOT}:{ROOT / 'client'}"
    program = [sys.executable, "-c", FORKED]
    done = subprocess.run(program, env={"SERVICE": url, "PYTHONPATH": path}, timeout=60, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert sorted(map(ports.count, set(ports))) == [1, 2]


def problem() -> RevisitProblem:
    return RevisitProblem(wire.Problem.model_validate(answers.problem("not-found", 404)), 2.5)


def job() -> wire.Job:
    return wire.Job.model_validate(answers.job(state="cancelled"))


@pytest.mark.parametrize(
    "error", [problem(), Unreachable("http://robot", "no answer in time"), JobFailed(job()), Unsendable("no id")]
)
def test_errors_come_out_of_pools_of_processes_as_they_were(error: ClientError) -> None:
    """`multiprocessing` waits for ever, and `concurrent.futures` breaks, on one that cannot be read back."""
    error.add_note("robot 7")
    for other in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert (type(other), str(other), vars(other)) == (type(error), str(error), vars(error))


@pytest.mark.parametrize("proxy", ["http://127.0.0.1:9", "socks5://127.0.0.1:9"])
def test_no_proxy_gets_what_this_machine_serves(
    callers: tuple[str, list[int]], proxy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HTTP_PROXY", "ALL_PROXY"):
        monkeypatch.setenv(name, proxy)
    with Revisit(callers[0], patience=0) as revisit:
        assert revisit.maps() == []


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ALL_PROXY", "socks5://proxy:1080"),
        ("HTTPS_PROXY", "proxy://x"),
        ("HTTPS_PROXY", "http://proxy:port"),
        ("SSL_CERT_FILE", "/no"),
    ],
)
def test_an_environment_that_cannot_be_used_is_named(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY", "SSL_CERT_FILE", "SSL_CERT_DIR"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv(variable, value)
    with pytest.raises(ClientError, match=f"^{variable} cannot be used: "):
        Revisit("https://places.example")


@pytest.mark.parametrize("url", ["localhost:8000", "127.0.0.1:8000", "ftp://places.example", "http:/places", "http://"])
def test_an_address_without_a_scheme_or_a_host_is_told_at_once(url: str) -> None:
    with pytest.raises(Unsendable, match=r"no address of a service, as http://127.0.0.1:8000 is"):
        Revisit(url)


@pytest.mark.parametrize("key", ["Straße-1", "a\nb", "a b", "x" * 256])
def test_an_idempotency_key_that_no_header_carries_is_told_at_once(key: str) -> None:
    revisit = client(lambda _: httpx.Response(201, json=answers.enrolled()))
    with pytest.raises(Unsendable, match=r"the Idempotency-Key is .*visible ASCII"):
        revisit.enroll(b"x", idempotency_key=key)


def test_a_download_waits_for_a_busy_service(tmp_path: Path) -> None:
    clock = Clock()
    busy = refused("too-many-requests", 429, **{"retry-after": "2"})
    revisit = client(in_turn(busy, httpx.Response(200, stream=httpx.ByteStream(b"all of it"))), clock)
    assert revisit.download_snapshot("id", tmp_path / "map.snapshot").read_bytes() == b"all of it"
    assert clock.naps == [2.0]
