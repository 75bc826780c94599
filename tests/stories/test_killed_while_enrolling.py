"""The power goes while pictures are being enrolled: nothing acknowledged is lost, and nothing half-made is left."""

import hashlib
import itertools
import random
import sqlite3
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from tests.stories.running import RunningService

KILLS = 12
SENDERS = 3
PNG = {"content-type": "image/png"}


def image(number: int) -> bytes:
    """A small picture that no other number has."""
    pixels = np.random.default_rng(number).integers(0, 255, (12, 16, 3), np.uint8)
    large = cv2.resize(pixels, (160, 120), interpolation=cv2.INTER_NEAREST)
    encoded: np.ndarray = cv2.imencode(".png", large)[1]
    return encoded.tobytes()


@dataclass
class Ledger:
    """What was sent, and what was acknowledged."""

    acknowledged: dict[str, str] = field(default_factory=dict)  # view id -> SHA-256 of what was sent
    numbers: Iterator[int] = field(default_factory=itertools.count)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send(self, url: str, until: threading.Event, wait: bool) -> None:
        """Enrol picture after picture until the service is gone."""
        with httpx.Client(base_url=url, timeout=30) as client:
            while not until.is_set():
                with self.lock:
                    data = image(next(self.numbers))
                try:
                    answer = client.post(
                        "/enroll",
                        params={"wait": str(wait).lower()},
                        content=data,
                        headers=PNG,
                    )
                except httpx.TransportError:
                    return
                if answer.status_code in (200, 201, 202):
                    with self.lock:
                        self.acknowledged[answer.json()["view"]["id"]] = hashlib.sha256(data).hexdigest()

    def await_more(self, count: int) -> None:
        """Until so many more are acknowledged: moments that do not depend on how fast the machine is."""
        goal = len(self.acknowledged) + count
        until = time.monotonic() + 60
        while len(self.acknowledged) < goal:
            assert time.monotonic() < until, "nothing is acknowledged any more"
            time.sleep(0.005)


def settle(client: httpx.Client) -> None:
    """Wait until nothing is pending."""
    for _ in range(1200):
        answer = client.get("/maps")
        if all(facts["views"]["pending"] == 0 for facts in answer.json()["maps"]):
            return
        time.sleep(0.05)
    raise AssertionError("pictures are still pending")


@pytest.mark.slow
def test_every_acknowledged_view_survives_sigkill_at_any_moment(tmp_path: Path) -> None:
    """Twelve kills at seeded moments, with three clients enrolling, some of them without waiting."""
    chance = random.Random(20)
    ledger = Ledger()
    for _ in range(KILLS):
        service = RunningService(tmp_path / "data")
        gone = threading.Event()
        senders = [
            threading.Thread(target=ledger.send, args=(service.url, gone, number != 0)) for number in range(SENDERS)
        ]
        for sender in senders:
            sender.start()
        ledger.await_more(chance.randrange(8))
        time.sleep(chance.uniform(0, 0.1))
        service.kill()
        gone.set()
        for sender in senders:
            sender.join()
    with RunningService(tmp_path / "data") as service, httpx.Client(base_url=service.url, timeout=60) as client:
        settle(client)
        for view_id, digest in ledger.acknowledged.items():
            answer = client.get(f"/views/{view_id}")
            assert answer.status_code == 200, f"{view_id} was acknowledged and is gone"
            assert answer.json()["state"] == "ready"
            assert hashlib.sha256(client.get(f"/views/{view_id}/image").content).hexdigest() == digest
        for view_id in chance.sample(sorted(ledger.acknowledged), 10):
            data = client.get(f"/views/{view_id}/image").content
            found = client.post("/query", content=data, headers=PNG).json()
            assert found["matches"][0]["view"]["id"] == view_id
        views = client.get("/maps/default").json()["views"]
        assert views["failed"] == 0
        assert found["searched"] == views["ready"], "the index and the store disagree"
        assert service.stop() == 0

    every = (tmp_path / "data" / "pictures").rglob("*")
    files = [path for path in every if path.is_file() and path.name != ".lock"]
    with sqlite3.connect(tmp_path / "data" / "revisit.db") as database:
        kept = {row[0] for row in database.execute("SELECT DISTINCT sha256 FROM views")}
        (ready,) = database.execute("SELECT count(*) FROM descriptions").fetchone()
    database.close()
    assert {path.stem for path in files} == kept, "a picture without a view, or a view without its picture"
    assert ready == views["ready"]
    for path in files:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == path.stem
