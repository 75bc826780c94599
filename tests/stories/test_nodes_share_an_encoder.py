"""Services without a network of their own send images to one encoder; it dies, hangs and comes back."""

import re
import signal
import socket
import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import pytest

from scenes import scene
from tests.stories.importing import ZIP, ended, zipped
from tests.stories.photos import photo
from tests.stories.running import RunningEncoder, RunningService
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.one_database("the encoder is elsewhere, not the database")

JPEG = {"content-type": "image/jpeg"}
KEY = "0123456789abcdef0123456789abcdef"
WAIT_S = 16.0

PATIENT_S = 40.0
"""Of a node whose encoder draws: finer labels take many times as long as a description, and a call gets a quarter."""


@cache
def street(number: int) -> bytes:
    return photo(scene(f"street {number}"))


@pytest.fixture
def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def encoder(port: int, **settings: str) -> RunningEncoder:
    return RunningEncoder(port, REVISIT_ENCODER_KEY=KEY, **settings)


def node(data: Path, port: int | None, **settings: str) -> RunningService:
    """A service with the built-in encoder, of which the network is elsewhere unless `port` is None."""
    shared = {} if port is None else {
        "REVISIT_ENCODER_URL": f"http://127.0.0.1:{port}", "REVISIT_ENCODER_KEY": KEY,
    }  # fmt: skip
    return RunningService(
        data, False, **{"REVISIT_ENCODER": "compact", "REVISIT_WAIT": str(WAIT_S), **shared, **settings}
    )


def calls(service: RunningService) -> httpx.Client:
    return httpx.Client(base_url=service.url, timeout=60, headers=JPEG)


def enrolled(client: httpx.Client, number: int, *, wait: bool = False, into: str = "default") -> Any:
    params = {"wait": str(wait).lower(), "map": into, "place": str(number)}
    answer = client.post("/enroll", params=params, content=street(number))
    assert answer.status_code in (201, 202), answer.text
    return answer.json()["view"]


def queried(client: httpx.Client, number: int) -> tuple[httpx.Response, float]:
    began = time.monotonic()
    return client.post("/query", content=street(number)), time.monotonic() - began


def until_all(client: httpx.Client, views: list[str], state: str, within_s: float = 60) -> None:
    until = time.monotonic() + within_s
    while states := {client.get(f"/views/{view}").json()["state"] for view in views} - {state}:
        assert "failed" not in states
        assert time.monotonic() < until, states
        time.sleep(0.1)


def drawn(client: httpx.Client, view: str, name: str) -> httpx.Response:
    """The drawing of a view; asked for again where the machine was too busy to draw it in time."""

    def answered() -> httpx.Response | None:
        answer = client.get(f"/views/{view}/{name}.png")
        if answer.status_code == 503:
            return None
        assert answer.status_code == 200, answer.text
        return answer

    return until(answered)


def until_ready(client: httpx.Client, *, ready: bool = True) -> Any:
    until = time.monotonic() + PATIENCE_S
    while (answer := client.get("/readyz")).status_code != (200 if ready else 503):
        assert time.monotonic() < until, answer.text
        time.sleep(0.05)
    return answer.json()


def test_an_encoder_that_dies_or_hangs_loses_no_image_and_keeps_no_query_waiting(
    tmp_path: Path, port: int, stack: ExitStack
) -> None:
    first = stack.enter_context(encoder(port))
    a, b = (stack.enter_context(calls(stack.enter_context(node(tmp_path / name, port)))) for name in ("a", "b"))
    for client in (a, b):
        until_ready(client)
    kept = {a: [enrolled(a, 0, wait=True)["id"]], b: [enrolled(b, 0, wait=True)["id"]]}

    for number in range(1, 13):  # killed amid enrolment
        for client in (a, b):
            kept[client].append(enrolled(client, number)["id"])
        if number == 8:
            first.kill()
    for client in (a, b):
        answer, took_s = queried(client, 0)
        assert answer.status_code == 503
        assert answer.headers["content-type"] == "application/problem+json"
        assert int(answer.headers["retry-after"]) >= 1
        assert f"the encoder at http://127.0.0.1:{port} cannot be reached" in answer.json()["detail"]
        assert took_s < WAIT_S / 2
        assert f"http://127.0.0.1:{port}" in until_ready(client, ready=False)["checks"]["encoder"]
        began = time.monotonic()
        view = enrolled(client, 20, wait=True)
        assert view["state"] == "pending"
        assert time.monotonic() - began < WAIT_S / 2
        kept[client].append(view["id"])

    second = stack.enter_context(encoder(port))
    for client in (a, b):
        until_all(client, kept[client], "ready")
        until_ready(client)
        for number in (3, 12, 20):
            answer, _ = queried(client, number)
            assert answer.json()["matches"][0]["view"]["place"] == str(number)

    second.signal(signal.SIGSTOP)  # it hangs
    with ThreadPoolExecutor(4) as callers:
        for answer, took_s in callers.map(lambda number: queried(a, number), range(4)):
            assert answer.status_code == 503
            assert f"the encoder at http://127.0.0.1:{port} does not answer" in answer.json()["detail"]
            assert took_s < WAIT_S
    late = enrolled(a, 30)["id"]
    second.signal(signal.SIGCONT)
    until_all(a, [late], "ready")
    answer, _ = queried(a, 30)
    assert answer.json()["matches"][0]["view"]["id"] == late


def test_a_service_stops_in_order_while_the_encoder_is_away_and_describes_later(
    tmp_path: Path, port: int, stack: ExitStack
) -> None:
    with node(tmp_path / "a", port) as service, calls(service) as client:
        views = [enrolled(client, number)["id"] for number in range(3)]
        began = time.monotonic()
        assert service.stop() == 0
        assert time.monotonic() - began < 20
    stack.enter_context(encoder(port))
    with node(tmp_path / "a", port) as service, calls(service) as client:
        until_all(client, views, "ready")


def test_views_encoded_here_and_there_are_the_same_to_the_byte(tmp_path: Path, port: int, stack: ExitStack) -> None:
    stack.enter_context(encoder(port))
    numbers = range(4)
    still = {"REVISIT_COMPARE": "false"}  # what is compared in the background changes confidences
    with node(tmp_path / "a", port, **still) as service, calls(service) as client:
        until_ready(client)
        for number in numbers:
            enrolled(client, number, wait=True, into="there")
        by_shared = client.post("/query", params={"map": "there"}, content=street(7)).json()
    with node(tmp_path / "a", None, **still) as service, calls(service) as client:
        for number in numbers:
            enrolled(client, number, wait=True, into="here")
        in_process = client.post("/query", params={"map": "there"}, content=street(7)).json()

    assert by_shared["matches"] == in_process["matches"]
    assert by_shared["confidence"] == in_process["confidence"]
    with sqlite3.connect(tmp_path / "a" / "revisit.db") as database:
        for part in ("vectors", "appearances", "cells", "keypoints"):
            rows = database.execute(
                f"SELECT v.sha256, part.recipe, part.body FROM {part} part JOIN views v ON v.seq = part.seq"
            ).fetchall()
            assert len(rows) == 2 * len(numbers)
            assert len(set(rows)) == len(numbers)  # of each image once from there and once from here
    database.close()


def test_images_of_several_nodes_are_encoded_together(tmp_path: Path, port: int, stack: ExitStack) -> None:
    sharing = stack.enter_context(encoder(port, REVISIT_BATCH="8"))
    # Each sends one image at a time: a batch of two has images of two nodes.
    nodes = [stack.enter_context(node(tmp_path / name, port, REVISIT_BATCH="1")) for name in ("a", "b", "c")]
    clients = [stack.enter_context(calls(service)) for service in nodes]
    for client in clients:
        until_ready(client)
    for number in range(12):
        street(number)  # is drawn before it is timed
    with ThreadPoolExecutor(len(clients)) as callers:
        views = list(callers.map(lambda client: [enrolled(client, number)["id"] for number in range(12)], clients))
    for client, kept in zip(clients, views, strict=True):
        until_all(client, kept, "ready")

    text = httpx.get(f"{sharing.url}/metrics", headers={"authorization": f"Bearer {KEY}"}).text
    found = re.findall(r'revisit_encoder_batch_images_bucket\{le="(\S+)"\} (\S+)', text)
    alone, all_batches = float(dict(found)["1.0"]), float(dict(found)["+Inf"])
    print(f"{all_batches - alone:.0f} of {all_batches:.0f} batches had images of several nodes")
    assert all_batches > alone


def test_drawings_and_what_is_blurred_come_from_the_encoder_and_nothing_is_stored_while_it_is_away(
    tmp_path: Path, port: int, stack: ExitStack
) -> None:
    first = stack.enter_context(encoder(port))
    with node(tmp_path / "local", None) as service, calls(service) as client:
        view = enrolled(client, 1, wait=True)
        alone = [drawn(client, view["id"], name).content for name in ("segmentation", "graph")]
    shared = stack.enter_context(node(tmp_path / "a", port, REVISIT_WAIT=str(PATIENT_S)))
    client = stack.enter_context(calls(shared))
    until_ready(client)
    view = enrolled(client, 1, wait=True)
    segmentation, graph = (drawn(client, view["id"], name) for name in ("segmentation", "graph"))
    assert segmentation.headers["Revisit-Drawn-By"] == "segmenter"
    assert (segmentation.content == alone[0], graph.content == alone[1]) == (True, True)

    client.put("/maps/street", json={}).raise_for_status()
    client.patch("/maps/street", json={"blur": ["people", "vehicles"]}).raise_for_status()
    blurred = enrolled(client, 2, wait=True, into="street")
    assert blurred["state"] == "ready"
    first.kill()
    began = time.monotonic()
    refused = client.post("/enroll", params={"map": "street"}, content=street(3))
    assert time.monotonic() - began < PATIENT_S
    assert (refused.status_code, refused.json()["type"].rpartition(":")[2]) == (503, "unavailable")
    assert int(refused.headers["retry-after"]) >= 1
    assert client.get(f"/views/{view['id']}/segmentation.png").status_code == 503
    job = client.post("/maps/street/imports", content=zipped({"3.jpg": street(3)}), headers=ZIP).json()
    time.sleep(2)
    assert client.get(f"/jobs/{job['id']}").json()["state"] in ("waiting", "running")
    assert client.get("/maps/street").json()["views"]["ready"] == 1
    assert len(list((tmp_path / "a" / "pictures").rglob("*.*"))) == 2  # nothing was stored that was not blurred

    stack.enter_context(encoder(port))
    told = ended(client, job["id"])
    assert (told["state"], told["result"]["enrolled"], told["result"]["failed"]) == ("done", 1, 0)


def test_another_key_is_refused_when_a_service_starts(tmp_path: Path, port: int, stack: ExitStack) -> None:
    stack.enter_context(encoder(port))

    with pytest.raises(AssertionError, match="refuses the key; give both REVISIT_ENCODER_KEY the same value"):
        node(tmp_path / "a", port, REVISIT_ENCODER_KEY="another" * 3)
