"""Robots with a short timeout give up and ask again: whoever is patient does not wait for those who have gone."""

import base64
import json
import logging
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app.http.application import create_app
from app.http.geopose import OSCP_VERSION
from app.http.server import Server, configured
from schemas.description import PixelField
from schemas.image import Image
from schemas.records import ViewAttributes
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from tests.waiting import PATIENCE_S, until
from worker.encoders.color import ColorEncoder
from worker.runtime import Runtime, build

pytestmark = pytest.mark.one_database("the database has no part in it")

PHOTO = encoded(drawn(320, 240, 0), "jpeg")
JPEG = {"content-type": "image/jpeg"}
QUERIES = 8


class Gate:
    """Lets queries through to the encoder one by one."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.entered, self.open = threading.Semaphore(0), threading.Semaphore(0)
        encode = ColorEncoder.encode

        def held(encoder: ColorEncoder, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
            self.entered.release()
            assert self.open.acquire(timeout=PATIENCE_S)
            return encode(encoder, images, urgent=urgent)

        monkeypatch.setattr(ColorEncoder, "encode", held)


@pytest.fixture
def runtime(tmp_path: Path) -> Runtime:
    return build(settings(tmp_path, queries=QUERIES, decoders=1, compare=False))


@pytest.fixture
def port(runtime: Runtime) -> Iterator[int]:
    """Of the service, behind the server and the connections that it has as a process."""
    opened = threading.Event()
    listening = socket.create_server(("127.0.0.1", 0))
    server = Server(configured(create_app(runtime), runtime.settings), 5, lambda: None, opened.set)
    running = threading.Thread(target=server.run, args=([listening],))
    running.start()
    assert opened.wait(PATIENCE_S)
    until(lambda: runtime.scheduler.alive)
    runtime.services.enroll.enroll(PHOTO, "town", ViewAttributes(place="hall"), patience_s=PATIENCE_S)
    yield listening.getsockname()[1]
    server.should_exit = True
    running.join(PATIENCE_S)


@pytest.fixture
def gate(port: int, monkeypatch: pytest.MonkeyPatch) -> Gate:
    """From now on; what was enrolled before was encoded."""
    return Gate(monkeypatch)


def request(address: str, body: bytes = PHOTO, /, **headers: str) -> bytes:
    lines = {"Host": "robot", "Content-Length": str(len(body)), "Content-Type": "image/jpeg", **headers}
    head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    return f"POST {address} HTTP/1.1\r\n{head}\r\n".encode() + body


def sent(port: int, data: bytes) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
    connection.sendall(data)
    return connection


def by_query() -> bytes:
    return request("/query?map=town")


def by_geopose() -> bytes:
    readings = [{"timestamp": 1, "sensorId": "0", "imageBytes": base64.b64encode(PHOTO).decode()}]
    posed = {
        "id": "8f6e6e1e-3d3f-4f0d-9d57-0a9f5f6f7f10",
        "timestamp": 1,
        "type": "geopose",
        "sensors": [{"id": "0", "type": "camera"}],
        "sensorReadings": {"cameraReadings": readings},
    }
    headers = {"Content-Type": "application/json", "Accept": OSCP_VERSION}
    return request("/localize/geopose?map=town", json.dumps(posed).encode(), **headers)


def by_compreface() -> bytes:
    part = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.jpg"\r\n\r\n' + PHOTO + b"\r\n--b--\r\n"
    form = {"Content-Type": "multipart/form-data; boundary=b"}
    return request("/compat/compreface/town/api/v1/recognition/recognize", part, **form)


@pytest.mark.parametrize("asking", [by_query, by_geopose, by_compreface])
def test_a_patient_caller_goes_before_all_who_have_gone(
    runtime: Runtime, port: int, gate: Gate, asking: Callable[[], bytes], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "revisit.access")
    encoded_before = runtime.scheduler.encoded
    with ExitStack() as robots:
        robots.enter_context(sent(port, asking()))
        assert gate.entered.acquire(timeout=PATIENCE_S)  # the first is being encoded
        for _ in range(QUERIES - 1):
            robots.enter_context(sent(port, asking()))
        until(lambda: runtime.scheduler.queries_waiting == QUERIES)
        refused = httpx.post(f"http://127.0.0.1:{port}/query?map=town", content=PHOTO, headers=JPEG)
        assert refused.status_code == 429
    until(lambda: runtime.scheduler.queries_waiting == 1)  # although the encoder still has the first

    with ThreadPoolExecutor(1) as patient:
        waiting = patient.submit(
            httpx.post, f"http://127.0.0.1:{port}/query?map=town", content=PHOTO, headers=JPEG, timeout=PATIENCE_S
        )
        until(lambda: runtime.scheduler.queries_waiting == 2)
        gate.open.release(2)
        answer = waiting.result(PATIENCE_S)
    assert (answer.status_code, answer.json()["status"]) == (200, "matched")
    assert runtime.scheduler.encoded - encoded_before == 2

    def statuses() -> list[Any]:
        return [vars(line)["status"] for line in caplog.records if line.name == "revisit.access"]

    until(lambda: len(statuses()) == QUERIES + 2)
    assert statuses().count(0) == QUERIES - 1  # what was being encoded was finished for nobody
    assert 500 not in statuses()


def test_an_image_of_a_drive_counts_once_whatever_became_of_it_before(runtime: Runtime, port: int, gate: Gate) -> None:
    """Given up while it waited, or while it was encoded, and sent again with its key."""

    def query(key: str) -> bytes:
        return request("/query?map=town&drive=robot-1", PHOTO, **{"Idempotency-Key": key})

    with sent(port, query("1")):
        assert gate.entered.acquire(timeout=PATIENCE_S)
        with sent(port, query("2")):
            until(lambda: runtime.scheduler.queries_waiting == 2)
    until(lambda: runtime.scheduler.queries_waiting == 1)
    gate.open.release(99)
    until(lambda: runtime.scheduler.queries_waiting == 0)

    images = []
    for key in "12":
        headers = {**JPEG, "idempotency-key": key}
        address = f"http://127.0.0.1:{port}/query?map=town&drive=robot-1"
        images.append(httpx.post(address, content=PHOTO, headers=headers, timeout=60).json()["drive"]["images"])
    assert images == [1, 2]


def test_requests_that_are_sent_ahead_are_all_answered(port: int, gate: Gate) -> None:
    """HTTP/1.1 pipelining: what comes behind a query is no sign that its caller has gone."""
    with sent(port, by_query() + by_query()) as connection:
        assert gate.entered.acquire(timeout=PATIENCE_S)
        connection.sendall(request("/query?map=town", Connection="close"))
        gate.open.release(3)
        answers = b""
        while piece := connection.recv(65536):
            answers += piece
    assert answers.count(b"HTTP/1.1 200 OK") == 3


def test_large_photos_wait_as_they_were_sent(runtime: Runtime, port: int, gate: Gate) -> None:
    """The pixels of two of 32 megapixels fill the room; the others are decoded when it is their turn."""
    large = request("/query?map=town", encoded(np.full((5000, 6400, 3), 99, np.uint8), "png"), Connection="close")
    with ExitStack() as robots:
        waiting = [robots.enter_context(sent(port, large)) for _ in range(QUERIES)]
        until(lambda: (runtime.scheduler.queries_waiting, runtime.services.query.outside) == (2, QUERIES - 2))
        shown = httpx.get(f"http://127.0.0.1:{port}/metrics").text
        assert f"revisit_queries_waiting {QUERIES}.0" in shown
        refused = httpx.post(f"http://127.0.0.1:{port}/query?map=town", content=PHOTO, headers=JPEG)
        assert refused.status_code == 429
        gate.open.release(QUERIES)
        answers = [b"".join(iter(lambda: connection.recv(65536), b"")) for connection in waiting]  # noqa: B023
    assert all(answer.startswith(b"HTTP/1.1 200 OK") for answer in answers)
