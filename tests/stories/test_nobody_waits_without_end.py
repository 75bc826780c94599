"""Whoever waits is answered: without a worker, behind a long queue, when a worker is killed, when the service stops."""

import signal
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import httpx
import pytest

from app.http.application import create_app
from schemas.description import Description
from schemas.errors import StorageFailed
from schemas.records import ViewRecord
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.stories.running import RunningService, settings, worker
from tests.waiting import PATIENCE_S, until
from worker.description.describer import Describer
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
WAIT_S = 1.0


def is_done(client: httpx.Client, job: str) -> bool:
    """Whether a job has ended well."""
    return bool(client.get(f"/jobs/{job}").json()["state"] == "done")


def readiness(client: httpx.Client, ready: bool) -> Any:
    """The readiness once it is so."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        told = client.get("/readyz").json()
        if told["ready"] is ready:
            return told
        time.sleep(0.05)
    raise AssertionError(f"still {told}")


def test_without_a_worker_callers_are_told_and_a_killed_one_is_noticed_within_seconds(tmp_path: Path) -> None:
    data = tmp_path / "data"
    with (
        RunningService(data, False, REVISIT_INLINE_WORKER="false", REVISIT_LEASE_S="2") as service,
        httpx.Client(base_url=service.url, timeout=40) as client,
    ):
        assert "revisit worker" in readiness(client, False)["checks"]["worker"]
        refused = client.post("/enroll", content=photo(1), headers=JPEG)
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:revisit:problem:unavailable")
        assert "worker" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) > 0
        assert client.get("/views").json()["views"] == [], "a refused image left something behind"

        kept = client.post("/enroll?wait=false", content=photo(2), headers=JPEG)
        assert kept.status_code == 202
        with worker(data, REVISIT_LEASE_S="2") as process:
            readiness(client, True)
            assert client.post("/enroll", content=photo(1), headers=JPEG).status_code == 201
            assert client.get(f"/jobs/{kept.json()['job']}").json()["state"] == "done"
            process.send_signal(signal.SIGKILL)
            process.wait()
            killed = time.monotonic()
            readiness(client, False)
            assert time.monotonic() - killed < Settings.model_fields["lease_s"].default
        assert client.post("/enroll", content=photo(3), headers=JPEG).status_code == 503


def test_a_killed_service_finds_its_own_claims_again_at_once(tmp_path: Path) -> None:
    """Its jobs were claimed by a process that is gone: nobody waits for a lease to end."""
    data = tmp_path / "data"
    with (
        RunningService(data, REVISIT_LEASE_S="600") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        jobs = [
            client.post("/enroll?wait=false", content=photo(seed), headers=JPEG).json()["job"] for seed in range(30)
        ]
        service.kill()
    with (
        RunningService(data, REVISIT_LEASE_S="600") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        until(lambda: all(is_done(client, job) for job in jobs))  # or else their leases end in ten minutes


@pytest.fixture(params=[WAIT_S])
def stuck(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[CheckedClient, Any, threading.Event]]:
    """A service whose describing takes until it is let go, and whose callers wait for so many seconds at most."""
    go = threading.Event()
    describe = Describer.describe

    def slow(self: Describer, *rest: Any) -> Description:
        go.wait(4 * PATIENCE_S)
        return describe(self, *rest)

    monkeypatch.setattr(Describer, "describe", slow)
    runtime = build(settings(tmp_path, wait=request.param))
    with CheckedClient(create_app(runtime)) as client:
        yield client, runtime, go
        go.set()


def test_waiting_ends_with_202_and_the_job_after_the_bound(stuck: tuple[CheckedClient, Any, threading.Event]) -> None:
    client, _, go = stuck
    began = time.monotonic()
    several = [("image", (f"{seed}.jpg", photo(seed), "image/jpeg")) for seed in range(12)]
    answer = client.post("/enroll", files=several)
    assert answer.status_code == 202
    assert WAIT_S <= time.monotonic() - began < len(several) / 2 * WAIT_S, "the images of one request share one bound"
    views = answer.json()["views"]
    assert all(one["job"] for one in views)
    assert client.post("/enroll", content=photo(9), headers=JPEG).headers["location"].startswith("/jobs/")
    go.set()
    for one in views:
        until(partial(is_done, client, one["job"]))


def test_behind_a_queue_that_is_longer_than_the_bound_nobody_waits(
    stuck: tuple[CheckedClient, Any, threading.Event],
) -> None:
    client, runtime, _ = stuck
    for seed in range(6):  # at 0.2 s an image, as long as none was measured
        client.post("/enroll?wait=false", content=photo(seed), headers=JPEG)
    waited_for: list[str] = []
    runtime.settlements.look = waited_for.append
    assert client.post("/enroll", content=photo(7), headers=JPEG).status_code == 202
    assert waited_for == []


@pytest.mark.parametrize("stuck", [4 * PATIENCE_S], indirect=True)
def test_callers_who_wait_are_answered_when_waiting_is_given_up(
    stuck: tuple[CheckedClient, Any, threading.Event],
) -> None:
    client, runtime, _ = stuck
    waiting = threading.Event()
    look = runtime.settlements.look

    def looked(view: str) -> Any:
        waiting.set()
        return look(view)

    runtime.settlements.look = looked
    answers = []
    caller = threading.Thread(
        target=lambda: answers.append(client.post("/enroll", content=photo(1), headers=JPEG).status_code)
    )
    caller.start()
    assert waiting.wait(PATIENCE_S)
    runtime.settlements.give_up()
    caller.join(PATIENCE_S)
    assert answers == [202]
    assert client.post("/enroll", content=photo(2), headers=JPEG).status_code == 202


def test_an_enrolment_whose_wait_breaks_off_is_acknowledged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The view is durable by then: an error would say that nothing is left of it."""
    runtime = build(settings(tmp_path))

    def away(view_id: str) -> ViewRecord:
        raise StorageFailed("the database server cannot be asked")

    with CheckedClient(create_app(runtime)) as client:
        monkeypatch.setattr(runtime.settlements, "look", away)
        kept = client.post("/enroll", content=photo(1), headers=JPEG)
        assert kept.status_code == 202, kept.text
        until(lambda: is_done(client, kept.json()["job"]))


def test_an_enrolment_that_was_waited_for_is_acknowledged_whatever_cannot_be_read_of_it_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = build(settings(tmp_path))

    def away(*_: object) -> NoReturn:
        raise StorageFailed("the database server cannot be asked")

    with CheckedClient(create_app(runtime)) as client:
        with monkeypatch.context() as failing:
            failing.setattr(runtime.services.enroll, "_resembles", away)
            kept = client.post("/enroll", content=photo(1), headers=JPEG)
            assert (kept.status_code, kept.headers["location"]) == (202, f"/jobs/{kept.json()['job']}"), kept.text
        until(lambda: is_done(client, kept.json()["job"]))
        again = client.post("/enroll", content=photo(1), headers=JPEG)
        assert (again.status_code, again.json()["view"]["id"]) == (200, kept.json()["view"]["id"])
