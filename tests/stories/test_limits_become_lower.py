"""A map that was made with large photos is served by a machine that takes small ones alone: it loses none of them."""

from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from tests.waiting import until
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
LARGE = encoded(drawn(1600, 1200, 1), "jpeg")
SMALL = encoded(drawn(320, 240, 2), "jpeg")
LOWER: dict[str, Any] = {"max_megapixels": 0.5, "max_body_mb": 0.08}


@pytest.mark.parametrize("decoders", [0, 1])
def test_a_photo_larger_than_what_is_taken_now_is_described_again_and_shown(tmp_path: Path, decoders: int) -> None:
    with CheckedClient(create_app(build(settings(tmp_path)))) as client:
        view = client.post("/enroll", content=LARGE, headers=JPEG).json()["view"]
        client.post("/enroll", content=SMALL, headers=JPEG)

    with CheckedClient(create_app(build(settings(tmp_path, decoders=decoders, **LOWER)))) as client:
        begun = client.post("/maps/default/recipe", json={"labels": ["road", "sky", "building"], "dynamic": []})
        job = until(lambda: (now := client.get(begun.headers["location"]).json())["state"] == "done" and now)
        assert job["failure"] is None
        assert client.get("/maps/default").json()["views"] == {"pending": 0, "ready": 2, "failed": 0}
        for name in ("image", "thumbnail", "segmentation.png", "graph.png"):
            assert client.get(f"/views/{view['id']}/{name}").status_code == 200, name
        answer = client.post("/query?explain=true", content=SMALL, headers=JPEG).json()
        for match in answer["matches"]:
            assert client.get(match["links"]["explanation"]).content.startswith(b"\x89PNG")
        refused = client.post("/query", content=LARGE, headers=JPEG)
        assert (refused.status_code, refused.json()["type"]) == (413, "urn:revisit:problem:body-too-large")
