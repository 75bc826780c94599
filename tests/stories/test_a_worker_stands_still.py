"""A worker stands still for longer than its lease, as on a machine that is paused, and wakes.

What others took up meanwhile is theirs, and what waits goes on.
"""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.running import RunningService, worker
from tests.waiting import until

pytestmark = pytest.mark.one_database("what a worker leaves lies in the data folder")

BRIEF = {"REVISIT_LEASE_S": "1"}
IMAGES = 80
PATIENCE_S = 5.0
"""After which a worker that stands still is taken for one that keeps others from writing: that is another story."""


def stands_still(process: Any, is_taken: Callable[[], bool]) -> bool:
    """Whether others took from a worker that is stopped what it was at; else it goes on."""
    process.send_signal(signal.SIGSTOP)
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if is_taken():
            return True
        time.sleep(0.05)
    process.send_signal(signal.SIGCONT)
    return False


def sent(client: httpx.Client, name: str, count: int) -> str:
    answer = client.post(f"/maps/{name}/imports", content=zipped(photos(count)), headers=ZIP)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def ready(client: httpx.Client, name: str) -> int:
    answer = client.get(f"/maps/{name}")
    return int(answer.json()["views"]["ready"]) if answer.status_code == 200 else 0


def further(client: httpx.Client, job: str, than: int) -> int | None:
    """How far the import got; None while that is no further than it was."""
    done = int((client.get(f"/jobs/{job}").json()["progress"] or {"done": 0})["done"])
    return done if done > than else None


def test_an_import_whose_only_worker_stood_still_goes_on_when_it_wakes(tmp_path: Path) -> None:
    with (
        RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false", **BRIEF) as service,
        worker(tmp_path, **BRIEF) as process,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        job = sent(client, "walk", IMAGES)
        furthest = 0

        def is_interrupted() -> bool:
            """Stop the worker, which got further than before: three times without are taken for three deaths."""
            nonlocal furthest
            furthest = until(lambda: further(client, job, furthest))
            return stands_still(process, lambda: client.get(f"/jobs/{job}").json()["state"] == "waiting")

        until(is_interrupted)
        assert ready(client, "walk") < IMAGES, "it was over before"
        process.send_signal(signal.SIGCONT)

        told = ended(client, job)
        assert (told["state"], told["failure"]) == ("done", None)
        assert (told["result"]["enrolled"], told["result"]["errors"]) == (IMAGES, [])
        until(lambda: not list((tmp_path / "imports").iterdir()))
