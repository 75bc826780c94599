"""What the service calls goes through the proxies of the environment, but for what this machine itself serves."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from app.http.webhooks import Webhooks
from schemas.errors import SetupError
from tests.stories.running import ROOT
from worker.encoders.inference_client import InferenceClient

CALLS = """
import sys
import app.http.webhooks, worker.encoders.inference_client
import httpx, requests
from botocore.utils import get_environ_proxies

url = sys.argv[1]
for host in ("127.0.0.1", "localhost"):
    here = url.replace("127.0.0.1", host)
    assert httpx.Client().get(here).text == requests.get(here).text == "here", host
    assert get_environ_proxies(here) == {}
client = httpx.Client()
assert client._transport_for_url(httpx.URL("http://[::1]:8101")) is client._transport
for elsewhere in ("http://encoder:8101/", "http://10.0.0.7/"):
    assert get_environ_proxies(elsewhere)["http"] == "http://127.0.0.1:9"
    try:
        httpx.Client().get(elsewhere)
    except httpx.ConnectError:
        pass
    else:
        raise AssertionError(elsewhere)
assert get_environ_proxies("http://store.example/") == {}
"""


@pytest.fixture
def here() -> Iterator[str]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-length", "4")
            self.end_headers()
            self.wfile.write(b"here")

        def log_message(self, format: str, *arguments: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def environment(**given: str) -> dict[str, str]:
    return {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}", **given}


@pytest.mark.parametrize("name", ["HTTP_PROXY", "http_proxy"])
@pytest.mark.parametrize("spared", ["NO_PROXY", "no_proxy"])
def test_what_this_machine_serves_is_called_directly(here: str, name: str, spared: str) -> None:
    proxies = environment(**{name: "http://127.0.0.1:9", spared: "store.example"})
    program = [sys.executable, "-W", "ignore", "-c", CALLS, here]
    done = subprocess.run(program, env=proxies, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, "None"),
        ({"NO_PROXY": "store.example"}, "None"),
        ({"HTTPS_PROXY": "http://p", "NO_PROXY": "*"}, "None"),
        ({"HTTPS_PROXY": "http://p", "no_proxy": "a, localhost"}, "a,localhost,127.0.0.1,::1"),
    ],
)
def test_what_the_environment_says_of_proxies_stays(given: dict[str, str], told: str) -> None:
    printed = "import worker, os; print(os.environ.get('no_proxy'))"
    done = subprocess.run(
        [sys.executable, "-c", printed], env=environment(**given), capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == told


@pytest.mark.parametrize("proxy", ["socks4://proxy:1080", "socks5://proxy:1080", "http://proxy:port"])
def test_a_proxy_that_cannot_be_used_is_told_at_the_start(proxy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that failed on it would tell nobody, and every event would be lost."""
    monkeypatch.setenv("ALL_PROXY", proxy)
    with pytest.raises(SetupError, match=r"REVISIT_WEBHOOK cannot be called: .*ALL_PROXY"):
        Webhooks("https://app.example/", None, ("matched",))
    with pytest.raises(SetupError, match=r"REVISIT_ENCODER_URL cannot be called: .*ALL_PROXY"):
        InferenceClient("https://encoder.example", "compact-1", {"semantic": 97})
