"""Keys that cannot be read, that are guessed, or that are lost while an answer lasts."""

import threading
import time
from datetime import UTC, datetime

import pytest

from app.http.keys import FAILURES
from schemas.keys import KeyRecord
from tests.http.fakes import FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import CheckedClient
from tests.waiting import until


def test_probes_do_not_wait_for_keys_that_cannot_be_read() -> None:
    """A database server that stands still; the service is alive all the same."""
    keys = KeyMaker()
    keys.make("operator", "admin")
    answering = threading.Event()
    read = keys.store.all

    def stands_still() -> list[KeyRecord]:
        answering.wait(30)
        return read()

    keys.store.all = stands_still  # type: ignore[method-assign]
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        try:
            for path in ("/livez", "/readyz", "/version", "/"):
                took_s = []
                for _ in range(3):  # the machine may have other work
                    keys.seconds += 1
                    began = time.perf_counter()
                    assert client.get(path).status_code == 200
                    took_s.append(time.perf_counter() - began)
                assert min(took_s) < 0.5
        finally:
            answering.set()


def test_no_request_waits_until_the_use_of_a_key_can_be_written_down() -> None:
    """Whoever else writes to the database may do so for a minute, and answers need none of it."""
    keys = KeyMaker()
    caller = {"x-api-key": keys.make("robot", "read")}
    going_on, written = threading.Event(), []

    def waits(key_id: str, hour: datetime) -> None:
        written.append(key_id)
        going_on.wait(30)

    keys.store.used = waits  # type: ignore[method-assign]
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        try:
            for _ in range(3):
                keys.seconds += 1
                began = time.perf_counter()
                assert client.get("/maps", headers=caller).status_code == 200
                assert time.perf_counter() - began < 5
        finally:
            going_on.set()
    assert len(written) == 1


@pytest.mark.parametrize("change", ["revoked", "first"])
def test_events_end_once_their_key_does_not_do_any_more(change: str) -> None:
    keys = KeyMaker()
    runtime = FakeRuntime(keys=keys.service)
    runtime.recogniser.job_states = ["running"] * 20 + ["done"]
    key = keys.make("robot", "read") if change == "revoked" else None

    def lose() -> None:
        until(lambda: len(runtime.recogniser.job_states) < 19)
        if change == "revoked":
            keys.service.revoke("robot", datetime.now(UTC))
        else:
            keys.make("operator", "admin")
        keys.seconds += 1

    losing = threading.Thread(target=lose)
    with CheckedClient(runtime.app()) as client:
        headers = {} if key is None else {"x-api-key": key}
        losing.start()
        answer = client.get("/jobs/j9/events", headers=headers)
        losing.join()
        assert answer.status_code == 200
        assert answer.text.count("event: job") == 1
        assert client.get("/jobs/j9/events", headers=headers).status_code == 401


def test_guesses_that_are_refused_are_counted_as_a_rate_and_not_as_a_full_queue() -> None:
    keys = KeyMaker()
    operator = keys.make("operator", "admin")
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        statuses = [client.get("/maps", headers={"x-api-key": "guess"}).status_code for _ in range(FAILURES + 5)]
        told = client.get("/metrics", headers={"x-api-key": operator}).text
    assert statuses == [401] * FAILURES + [429] * 5
    assert [line for line in told.splitlines() if line.startswith("revisit_rejected_total")] == [
        'revisit_rejected_total{reason="rate"} 5.0'
    ]
