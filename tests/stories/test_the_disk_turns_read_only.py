"""A file system turns itself read-only after an error, as ext4 does: everybody is answered, nothing is lost."""

import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from lab.faults.ext4_disk import Ext4Disk, ext4_disk
from lab.faults.small_disk import NotMounted
from tests.sample_images import drawn, encoded
from tests.stories.running import RunningService
from tests.waiting import until

pytestmark = pytest.mark.one_database("the disk is that of SQLite's file")

JPEG = {"content-type": "image/jpeg"}
WAIT_S = 5
ANSWER_S = WAIT_S + 5
SETTINGS = {"REVISIT_RESERVE_MB": "4", "REVISIT_WAIT": str(WAIT_S), "REVISIT_LEASE_S": "2", "REVISIT_COMPARE": "true"}
KEPT = range(6)


def image(number: int) -> bytes:
    """A JPEG that no other number has."""
    return encoded(drawn(320, 240, number))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Ext4Disk]:
    """A disk of its own."""
    try:
        with ext4_disk(tmp_path) as made:
            yield made
    except NotMounted as error:
        pytest.skip(f"NOT TRIED: a disk that turns read-only needs ext4 and the right to mount it ({error})")


class Callers:
    """Threads that call without a pause; what they were answered, and when."""

    def __init__(self, url: str, deletable: list[str]) -> None:
        self.acknowledged: list[int] = []
        self.deleted: list[str] = []
        self.refused: dict[str, float] = {}
        """When the first deletion of a view that was refused began."""
        self.answers: list[tuple[str, float, httpx.Response]] = []
        self._url, self._deletable = url, deletable
        self._stopping = threading.Event()
        self._threads = ThreadPoolExecutor(4)
        kinds = ("enroll", "enroll", "query", "delete")
        self._running = [self._threads.submit(self._call, kind, 10_000 * n) for n, kind in enumerate(kinds, 1)]

    def _call(self, kind: str, number: int) -> None:
        with httpx.Client(base_url=self._url, timeout=4 * ANSWER_S) as client:
            while not self._stopping.is_set():
                number += 1
                began = time.monotonic()
                if kind == "query":
                    answer = client.post("/query", content=image(number % len(KEPT)), headers=JPEG)
                elif kind == "enroll":
                    answer = client.post("/enroll", content=image(number), headers=JPEG)
                    if answer.status_code in (201, 202):
                        self.acknowledged.append(number)
                else:
                    view = self._deletable[-1]
                    answer = client.delete(f"/views/{view}")
                    if answer.status_code == 200:
                        self.deleted.append(self._deletable.pop())
                    if answer.status_code == 404 and view in self.refused:
                        self._deletable.pop()  # gone, or not, when the disk turned: nobody was told that it is
                        continue
                    if answer.status_code == 503:
                        self.refused.setdefault(view, began)
                    time.sleep(0.3)
                self.answers.append((kind, began, answer))
                assert time.monotonic() - began < ANSWER_S, answer.text

    def answered_since(self, moment: float) -> Counter[str]:
        """How many calls of each kind began after a moment and were answered."""
        return Counter(kind for kind, began, _ in self.answers[:] if began > moment)

    def stop(self) -> None:
        """Let each finish its call; raises what a call raised."""
        self._stopping.set()
        for one in self._running:
            one.result()
        self._threads.shutdown()


def told_of_disk(client: httpx.Client) -> dict[str, Any] | None:
    """What the service says of itself, if that is that something is wrong with its disk."""
    told: dict[str, Any] = client.get("/readyz").json()
    return told if told["checks"].get("disk", "ok") != "ok" else None


@pytest.mark.slow
def test_everybody_is_answered_and_what_was_acknowledged_is_there_after_a_repair(disk: Ext4Disk) -> None:
    with (
        RunningService(disk.at / "data", **SETTINGS) as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        ids = [client.post("/enroll", content=image(n), headers=JPEG).json()["view"]["id"] for n in KEPT]
        deletable = [
            client.post("/enroll", content=image(100 + n), headers=JPEG).json()["view"]["id"] for n in range(40)
        ]
        callers = Callers(service.url, deletable)
        until(lambda: callers.acknowledged and callers.deleted)
        disk.turn_read_only()
        with pytest.raises(OSError, match="Read-only"):
            (disk.at / "probe").write_text("")
        since = time.monotonic()
        told = until(lambda: told_of_disk(client))
        assert told["ready"] is False
        assert told["checks"]["encoder"] == "ok"
        enough = Counter(enroll=2, delete=2, query=4)
        until(lambda: callers.answered_since(since) >= enough)
        callers.stop()
        late = [(kind, answer) for kind, began, answer in callers.answers if began > since]
        for kind in ("enroll", "delete"):
            assert {answer.status_code for of, answer in late if of == kind} == {503}, kind
        assert {answer.headers["content-type"] for of, answer in late if of != "query"} == {"application/problem+json"}
        assert {answer.status_code for of, answer in late if of == "query"} == {200}
        service.signal(signal.SIGTERM)
        assert service.wait() == 0
        assert not [line for line in service.output if "Traceback" in line]

    disk.repair()
    with (
        RunningService(disk.at / "data", **SETTINGS) as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        until(lambda: client.get("/readyz").status_code == 200)
        for number, view in zip(KEPT, ids, strict=True):
            found = client.post("/query", content=image(number), headers=JPEG).json()
            assert found["matches"][0]["view"]["id"] == view
        for number in callers.acknowledged:
            assert client.post("/enroll", content=image(number), headers=JPEG).json()["created"] is False, "it was lost"
        for view in callers.deleted:
            assert client.get(f"/views/{view}").status_code == 404
        for view in deletable:
            image_there = client.get(f"/views/{view}/image").status_code == 200
            assert image_there is (client.get(f"/views/{view}").status_code == 200)
            # One that was being deleted when the disk turned is there, or gone: nobody was told.
            assert image_there or callers.refused.get(view, since) < since
        assert client.post("/enroll", content=image(99_999), headers=JPEG).json()["created"] is True
