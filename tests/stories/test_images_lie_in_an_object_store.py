"""A service whose images lie in an S3-compatible store: killed, and through a store that goes away and comes back."""

import time
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.storage.object_store import ObjectStore
from tests.stories.running import RunningService
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.one_database("a fleet on PostgreSQL has its images in such a store in four other stories")

JPEG = {"content-type": "image/jpeg"}


def until(client: httpx.Client, status: int) -> httpx.Response:
    began = time.monotonic()
    while (answer := client.get("/readyz")).status_code != status:
        assert time.monotonic() - began < PATIENCE_S
        time.sleep(0.05)
    return answer


def test_images_outlive_a_kill_and_callers_are_told_while_the_store_is_away(tmp_path: Path) -> None:
    objects = ObjectStore()
    with RunningService(tmp_path, **objects.environment) as service:
        sent = httpx.post(f"{service.url}/enroll", content=photo(1), headers=JPEG, timeout=40)
        view = sent.json()["view"]["id"]
        service.kill()
    with (
        RunningService(tmp_path, **objects.environment) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        found = client.post("/query", content=photo(1), headers=JPEG).json()
        assert found["matches"][0]["view"]["id"] == view
        assert client.get(f"/views/{view}/image").content == photo(1)
        assert len(objects.names()) == 1
        assert not (tmp_path / "pictures").exists()

        objects.stop()
        assert "image store s3://" in until(client, 503).json()["checks"]["database"]
        for method, path in (("POST", "/enroll"), ("GET", f"/views/{view}/image")):
            refused = client.request(method, path, content=photo(2) if method == "POST" else None, headers=JPEG)
            assert (refused.status_code, refused.json()["type"]) == (503, "urn:revisit:problem:unavailable"), path
            assert "cannot be reached" in refused.json()["detail"]
        again = client.post("/query", content=photo(1), headers=JPEG).json()
        assert again["matches"][0]["view"]["id"] == view

        objects.start()
        until(client, 200)
        assert client.post("/enroll", content=photo(2), headers=JPEG).status_code == 201
        assert client.get(f"/views/{view}/image").content == photo(1)
        assert "Traceback" not in "".join(service.output)
