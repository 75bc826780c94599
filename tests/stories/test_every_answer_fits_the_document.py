"""The real service, called on every route: each answer is held against the OpenAPI document by the client itself."""

from collections.abc import Iterator
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


def street(seed: int) -> bytes:
    return encoded(drawn(320, 240, seed), "jpeg")


@pytest.fixture
def client(tmp_path: Path) -> Iterator[CheckedClient]:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        yield client


def enroll(client: CheckedClient, seed: int, query: str = "map=campus", **headers: str) -> Any:
    return client.post(f"/enroll?{query}", content=street(seed), headers=JPEG | headers)


def test_a_map_from_its_first_image_to_its_end(client: CheckedClient) -> None:
    first = enroll(client, 0, "map=campus&place=gate&x=0&y=0&heading=90&captured_at=2026-03-01T09:30:00Z")
    assert first.status_code == 201
    assert enroll(client, 1, "map=campus&place=yard&x=5&y=0").status_code == 201
    assert enroll(client, 0).status_code == 200

    answer = client.post("/query?map=campus&explain=true", content=street(0), headers=JPEG).json()
    assert [match["view"]["place"] for match in answer["matches"]] == ["gate", "yard"]
    assert client.post("/query?map=campus&place=yard", content=street(0), headers=JPEG).json()["searched"] == 1
    assert client.post("/query?map=campus&near=0,0,1", content=street(1), headers=JPEG).json()["searched"] == 1

    view = first.json()["view"]
    drawings = [f"{view['links']['segmentation']}?overlay=true", f"{view['links']['graph']}?legend=true"]
    for link in (*view["links"].values(), *drawings):
        answer = client.get(link)
        assert answer.status_code == 200
        if "etag" in answer.headers:
            assert client.get(link, headers={"if-none-match": answer.headers["etag"]}).status_code == 304
    patched = client.patch(view["links"]["self"], json={"position": {"x": 1.5}, "metadata": {"floor": 2}}).json()
    assert (patched["position"]["x"], patched["position"]["heading"], patched["metadata"]) == (1.5, 90.0, {"floor": 2})

    for path in (
        "/maps",
        "/maps/campus",
        "/places",
        "/views?sort=-enrolled_at&limit=1",
        "/version",
        "/metrics",
        "/readyz",
    ):
        assert client.get(path).status_code == 200
    assert client.get("/views?limit=1&map=campus").json()["next"] is not None
    assert client.put("/maps/campus", json={"preset": "paper"}).status_code == 409
    assert client.put("/maps/empty", json={"preset": "paper"}).status_code == 201
    assert client.post("/query?map=empty", content=street(0), headers=JPEG).json()["status"] == "no_match"

    assert client.delete("/views?map=campus&place=yard").json()["views"] == 1
    assert client.delete(view["links"]["self"]).json()["views"] == 1
    assert client.delete("/maps/campus").status_code == 200
    assert client.get("/maps/campus").status_code == 404


def test_an_image_that_nobody_waits_for_and_a_call_that_is_repeated(client: CheckedClient) -> None:
    first = enroll(client, 3, "wait=false", **{"idempotency-key": "k1"})
    again = enroll(client, 3, "wait=false", **{"idempotency-key": "k1"})
    assert (first.status_code, again.content, again.headers["idempotent-replayed"]) == (202, first.content, "true")
    assert enroll(client, 4, "wait=false", **{"idempotency-key": "k1"}).status_code == 422

    until(lambda: client.get(first.headers["location"]).json()["state"] == "done")
    assert client.delete(first.headers["location"]).status_code == 409


def test_refusals_leave_nothing_behind(client: CheckedClient) -> None:
    assert enroll(client, 0, "map=m&x=1").status_code == 422
    cut = client.post("/enroll?map=m", content=street(0)[:-100], headers=JPEG)
    assert (cut.status_code, cut.json()["type"]) == (422, "urn:revisit:problem:undecodable-picture")
    assert client.post("/enroll?map=m&wait=false", content=street(0)[:-100], headers=JPEG).status_code == 422
    assert client.post("/query?map=m", content=street(0), headers=JPEG).status_code == 404
    assert client.get("/maps").json()["maps"] == []
    assert client.get("/views?cursor=nonsense").status_code == 422
