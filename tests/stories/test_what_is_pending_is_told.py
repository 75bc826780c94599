"""A view that nobody waited for is in the answer to a query, or the answer says that views are pending."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.stories.running import settings
from tests.waiting import PATIENCE_S, until
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}


def test_a_view_described_amid_a_search_is_found_or_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = build(settings(tmp_path))
    allowed = threading.Event()
    claim, index = runtime.store.jobs.claim, runtime.catalogue.index

    def held_back(*arguments: Any) -> Any:
        return claim(*arguments) if allowed.is_set() else []

    def described_meanwhile(name: str) -> Any:
        brought_up_to_date = index(name)
        allowed.set()
        deadline = time.monotonic() + PATIENCE_S
        while runtime.store.jobs.count_pending(name) and time.monotonic() < deadline:
            time.sleep(0.01)
        return brought_up_to_date

    monkeypatch.setattr(runtime.store.jobs, "claim", held_back)
    monkeypatch.setattr(runtime.catalogue, "index", described_meanwhile)
    with CheckedClient(create_app(runtime)) as client:
        kept = client.post("/enroll?wait=false", content=photo(1), headers=JPEG)
        amid = client.post("/query", content=photo(1), headers=JPEG).json()
        after = client.post("/query", content=photo(1), headers=JPEG).json()

    assert kept.status_code == 202
    assert (amid["matches"], amid["pending"]) == ([], 1)
    assert [match["view"]["id"] for match in after["matches"]] == [kept.json()["view"]["id"]]
    assert after["pending"] == 0


@pytest.mark.parametrize("before", [False, True])
def test_whoever_waits_is_told_that_the_description_was_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    """The view goes, unless an earlier call was told of it."""
    runtime = build(settings(tmp_path))
    monkeypatch.setattr(runtime.store.jobs, "claim", lambda *_: [])
    with CheckedClient(create_app(runtime)) as client, ThreadPoolExecutor() as threads:
        if before:
            assert client.post("/enroll?wait=false", content=photo(1), headers=JPEG).status_code == 202
        keyed = {**JPEG, "Idempotency-Key": "walk-7"}
        waiting = threads.submit(client.post, "/enroll?wait=true", content=photo(1), headers=keyed)
        until(lambda: runtime.settlements._waiting)
        [job] = client.get("/jobs?kind=describe").json()["jobs"]
        assert client.delete(f"/jobs/{job['id']}").json()["state"] == "cancelled"

        told = waiting.result()

        assert (told.status_code, told.json()["type"]) == (409, "urn:revisit:problem:conflict")
        assert "its description was cancelled; enrol the image again" in told.json()["detail"]
        assert (f"kept as view {job['view']}" in told.json()["detail"]) == before
        assert client.get(f"/views/{job['view']}").status_code == (200 if before else 404)
        # Sent again with its key, as `detail` says, it is not the old answer.
        again = threads.submit(client.post, "/enroll?wait=true", content=photo(1), headers=keyed)
        until(lambda: runtime.settlements._waiting)
        for one in client.get("/jobs?kind=describe").json()["jobs"]:
            client.delete(f"/jobs/{one['id']}")
        assert "idempotent-replayed" not in again.result().headers
