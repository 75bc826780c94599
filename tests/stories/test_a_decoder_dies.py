"""Decoders of the running service are killed again and again; every caller is answered, and nothing else stops."""

import os
import signal
import subprocess
import threading
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("what dies decodes, and stores nothing")


def decoders_of(service: RunningService) -> list[int]:
    listed = subprocess.run(["ps", "-A", "-o", "pid=,ppid=,args="], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 2) for line in listed.splitlines()]
    parent = str(service.pid)
    return [int(row[0]) for row in rows if row[1] == parent and "worker.images.apart.child" in row[2]]


def test_a_service_whose_decoders_are_killed_goes_on(tmp_path: Path) -> None:
    stop, answers = threading.Event(), list[int]()
    with (
        RunningService(tmp_path / "data", REVISIT_DECODERS="2") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):

        def send() -> None:
            seed = 0
            while not stop.is_set():
                seed += 1
                answers.append(client.post("/query", content=photo(seed % 7)).status_code)

        assert client.post("/enroll", content=photo()).status_code == 201
        sender = threading.Thread(target=send)
        sender.start()
        for _ in range(10):
            for pid in decoders_of(service):
                os.kill(pid, signal.SIGKILL)
            wanted = len(answers) + 3
            while len(answers) < wanted:
                threading.Event().wait(0.01)
        stop.set()
        sender.join()
        assert client.post("/query", content=photo()).json()["matches"]
        service.stop()
    assert set(answers) == {200}
