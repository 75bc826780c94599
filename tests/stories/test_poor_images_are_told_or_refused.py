"""A robot's camera is dirty, or the light is off: it is told when it enrols, not when it is lost."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from app.http.application import create_app
from schemas.image import Bytes2D
from schemas.records import ViewRecord
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.importing import ZIP, ended, zipped
from tests.stories.running import RunningService, settings
from worker.encoders.color import COLORS
from worker.runtime import build
from worker.service.attendance import Attendance
from worker.service.duplicates import NearDuplicates

JPEG = {"content-type": "image/jpeg"}
DARK = encoded((drawn(96, 64, 3) // 16).astype(np.uint8))
COVERED = encoded(np.full((64, 96, 3), 90, np.uint8))


def sharp(seed: int) -> bytes:
    """Fine structure, as photos of places have."""
    noise = np.random.default_rng(seed).integers(-60, 60, (240, 320, 1))
    return encoded(np.clip(drawn(320, 240, seed).astype(int) // 2 + 64 + noise, 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("poor")) as one:
        yield one


@pytest.fixture
def client(service: RunningService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, timeout=60) as one:
        yield one


def test_an_enrolment_warns_of_a_poor_image_and_keeps_it(client: httpx.Client) -> None:
    told = [
        client.post("/enroll?map=warned", content=image, headers=JPEG).json()["warnings"]
        for image in (sharp(1), DARK, COVERED)
    ]
    assert told[0] == []
    assert [[one["code"] for one in warnings] for warnings in told[1:]] == [["poor-picture"]] * 2
    assert "dark" in told[1][0]["detail"]
    assert "lens may be covered" in told[2][0]["detail"]
    assert client.get("/maps/warned").json()["views"]["ready"] == 3


def test_a_poor_image_is_refused_on_request_and_leaves_nothing(client: httpx.Client) -> None:
    refused = client.post("/enroll?map=strict&refuse_poor=true", content=DARK, headers=JPEG)
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
    assert client.get("/maps/strict").status_code == 404
    assert client.post("/enroll?map=strict&refuse_poor=true", content=sharp(2), headers=JPEG).status_code == 201

    images = [("image", (f"{i}.jpg", data, "image/jpeg")) for i, data in enumerate((sharp(3), DARK))]
    some = client.post("/enroll?map=strict&refuse_poor=true", files=images)
    assert some.status_code == 207
    assert [one["type"] for one in some.json()["errors"]] == ["urn:revisit:problem:poor-picture"]


def test_a_map_refuses_poor_images_where_nothing_else_is_said(client: httpx.Client) -> None:
    assert client.put("/maps/gate", json={}).json()["refuse_poor"] is False
    assert client.patch("/maps/gate", json={"refuse_poor": True}).json()["refuse_poor"] is True
    assert client.get("/maps/gate").json()["refuse_poor"] is True
    assert client.post("/enroll?map=gate", content=sharp(1), headers=JPEG).status_code == 201
    refused = client.post("/enroll?map=gate", content=DARK, headers=JPEG)
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
    compatible = client.post(
        "/compat/compreface/gate/api/v1/recognition/faces?subject=a", files={"file": ("a.jpg", DARK)}
    )
    assert compatible.status_code == 422
    answer = client.post("/maps/gate/imports", content=zipped({"0.jpg": sharp(2), "1.jpg": COVERED}), headers=ZIP)
    result = ended(client, answer.json()["id"])["result"]
    assert (result["enrolled"], result["failed"]) == (1, 1)
    # Whoever sends one may still say otherwise.
    assert client.post("/enroll?map=gate&refuse_poor=false", content=DARK, headers=JPEG).status_code == 201
    assert client.patch("/maps/gate", json={"refuse_poor": False}).json()["refuse_poor"] is False
    assert client.post("/enroll?map=gate", content=COVERED, headers=JPEG).json()["warnings"]
    for wrong in ({"refuse_poor": "yes"}, {"refuse_poor": None}, {}):
        assert client.patch("/maps/gate", json=wrong).status_code == 422
    assert client.patch("/maps/nowhere", json={"refuse_poor": True}).status_code == 404


@pytest.mark.parametrize(("refused", "counts"), [("false", (3, 0, 1)), ("true", (2, 1, 0))])
def test_an_import_counts_poor_images_or_leaves_them_out(
    client: httpx.Client, refused: str, counts: tuple[int, ...]
) -> None:
    files: dict[str, Any] = {"0.jpg": sharp(1), "1.jpg": DARK, "2.jpg": sharp(2)}
    answer = client.post(f"/maps/walk-{refused}/imports?refuse_poor={refused}", content=zipped(files), headers=ZIP)
    result = ended(client, answer.json()["id"])["result"]
    assert (result["enrolled"], result["failed"], result["poor"]) == counts
    assert [(one["file"], one["problem"]) for one in result["errors"]] == [("1.jpg", "poor-picture")] * counts[1]


def test_only_what_an_import_enrols_counts_as_poor(client: httpx.Client) -> None:
    """The same dark image twice, and one that is refused."""
    client.post("/enroll?map=counted&place=hall", content=COVERED, headers=JPEG)
    rows = "file,place\n2.jpg,roof\n"
    files: dict[str, Any] = {"0.jpg": DARK, "1.jpg": DARK, "2.jpg": COVERED, "manifest.csv": rows}
    answer = client.post("/maps/counted/imports", content=zipped(files), headers=ZIP)
    result = ended(client, answer.json()["id"])["result"]
    counts = [result[name] for name in ("enrolled", "already_there", "failed", "poor")]
    assert counts == [1, 1, 1, 1]


def crowd(share: float, seed: int) -> bytes:
    """A street of which cars cover some share, from below, in the colours that the encoder takes for labels."""
    pixels: Bytes2D = np.full((240, 320, 3), COLORS["building"], np.uint8)
    pixels[:20] = COLORS["sky"]
    pixels[240 - round(240 * share) :] = COLORS["car"]
    noise = np.random.default_rng(seed).integers(-9, 10, pixels.shape)
    return encoded(np.clip(pixels.astype(int) + noise, 0, 255).astype(np.uint8), "png")


def test_an_image_of_hardly_anything_but_cars_is_told_or_refused(client: httpx.Client) -> None:
    half, crowded = crowd(0.5, 1), crowd(0.9, 2)
    assert client.post("/enroll?map=fair", content=half, headers=JPEG).json()["warnings"] == []
    told = client.post("/enroll?map=fair", content=crowded, headers=JPEG).json()
    assert [one["code"] for one in told["warnings"]] == ["poor-picture"]
    assert told["warnings"][0]["detail"].endswith("% of the image shows things that move")
    assert told["view"]["state"] == "ready"
    answer = client.post("/query?map=fair", content=crowd(0.95, 3), headers=JPEG).json()
    assert answer["status"] == "matched" or answer["reason"]["code"] == "poor-picture"

    assert client.put("/maps/square", json={}).status_code == 201
    assert client.patch("/maps/square", json={"refuse_poor": True}).status_code == 200
    refused = client.post("/enroll?map=square", content=crowded, headers=JPEG)
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
    assert client.get("/maps/square").json()["views"] == {"pending": 0, "ready": 0, "failed": 0}
    assert client.get("/views?map=square").json()["views"] == []
    assert client.post("/enroll?map=square&refuse_poor=false", content=crowded, headers=JPEG).status_code == 201
    # There already: what was acknowledged stays.
    assert client.post("/enroll?map=square", content=crowded, headers=JPEG).status_code == 200
    assert client.get("/maps/square").json()["views"]["ready"] == 1


def wall(quality: int) -> bytes:
    """A wall of coloured tiles, saved more or less well."""
    tiles = np.random.default_rng(11).integers(0, 256, (12, 16, 3), np.uint8)
    return encoded(tiles.repeat(20, axis=0).repeat(20, axis=1), quality=quality)


def test_an_image_that_adds_nothing_is_told_or_refused(client: httpx.Client) -> None:
    assert client.put("/maps/wall", json={}).status_code == 201
    first = client.post("/enroll?map=wall", content=wall(92), headers=JPEG).json()["view"]["id"]
    assert client.patch("/maps/wall", json={"refuse_poor": True}).status_code == 200

    refused = client.post("/enroll?map=wall", content=wall(70), headers=JPEG)

    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
    assert "adds nothing" in refused.json()["detail"]
    assert first in refused.json()["detail"]
    assert [view["id"] for view in client.get("/views?map=wall").json()["views"]] == [first]
    told = client.post("/enroll?map=wall&refuse_poor=false", content=wall(70), headers=JPEG)
    assert (told.status_code, [one["code"] for one in told.json()["warnings"]]) == (201, ["duplicate"])
    assert client.post("/enroll?map=wall", content=sharp(5), headers=JPEG).status_code == 201


@pytest.mark.parametrize(("workers", "refuse", "looked"), [(1, "true", 1), (1, "false", 1), (2, "true", 2)])
def test_near_duplicates_are_looked_for_once_unless_another_worker_may_keep_one_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int, refuse: str, looked: int
) -> None:
    looks: list[str] = []
    look = NearDuplicates.of

    def counted(self: NearDuplicates, name: str, *said: Any, **how: Any) -> ViewRecord | None:
        looks.append(name)
        return look(self, name, *said, **how)

    monkeypatch.setattr(NearDuplicates, "of", counted)
    monkeypatch.setattr(Attendance, "able", workers)
    with CheckedClient(create_app(build(settings(tmp_path, compare=False)))) as client:
        answer = client.post(f"/enroll?map=wall&refuse_poor={refuse}", content=sharp(5), headers=JPEG)
    assert (answer.status_code, looks) == (201, ["wall"] * looked)


def settled(client: httpx.Client, view_id: str, within_s: float = 30) -> dict[str, Any]:
    """A view once it is described or failed."""
    until = time.monotonic() + within_s
    while (view := client.get(f"/views/{view_id}").json())["state"] == "pending":
        assert time.monotonic() < until, view
        time.sleep(0.02)
    return dict(view)


@pytest.mark.parametrize(("poor", "reason"), [(wall(70), "adds nothing"), (crowd(0.9, 2), "things that move")])
def test_whoever_does_not_wait_finds_the_refusal_at_the_view(client: httpx.Client, poor: bytes, reason: str) -> None:
    name = reason.replace(" ", "-")
    assert client.put(f"/maps/{name}", json={}).status_code == 201
    assert client.patch(f"/maps/{name}", json={"refuse_poor": True}).status_code == 200
    kept = client.post(f"/enroll?map={name}", content=wall(92), headers=JPEG).json()["view"]["id"]
    revision = client.get(f"/maps/{name}").json()["revision"]

    accepted = client.post(f"/enroll?map={name}&wait=false", content=poor, headers=JPEG)

    assert accepted.status_code == 202
    view = settled(client, accepted.json()["view"]["id"])
    assert view["state"] == "failed"
    assert view["failure"]["code"] == "poor-picture"
    assert reason in view["failure"]["detail"]
    job = client.get(f"/jobs/{accepted.json()['job']}").json()
    assert (job["state"], job["failure"]) == ("failed", view["failure"])
    found = client.post(f"/query?map={name}&top=10", content=poor, headers=JPEG).json()["matches"]
    assert [match["view"]["id"] for match in found] == [kept]
    assert client.get(f"/maps/{name}").json()["revision"] == revision  # it was never to be found
    # Whoever waits for the same image is told; what was acknowledged stays.
    told = client.post(f"/enroll?map={name}", content=poor, headers=JPEG)
    assert (told.status_code, told.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
    assert f"kept as view {view['id']}" in told.json()["detail"]
    # Another recipe is no way around the gate, nor the same once more; sending the image without it is.
    for dynamic in (["car", "cyclist"], ["car", "cyclist"], ["car"]):
        wanted = {"labels": ["road", "sky", "building", "car", "cyclist"], "dynamic": dynamic}
        begun = client.post(f"/maps/{name}/recipe", json=wanted)
        assert begun.status_code == 202, begun.text
        assert ended(client, begun.headers["location"].removeprefix("/jobs/"))["state"] == "done"
        assert client.get(f"/views/{view['id']}").json()["failure"] == view["failure"]
    again = client.post(f"/enroll?map={name}&refuse_poor=false", content=poor, headers=JPEG)
    assert (again.status_code, again.json()["view"]["state"]) == (200, "ready")


def test_who_sends_an_image_again_before_it_is_refused_finds_out_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot loses its connection and sends the image once more, without waiting, while the first is described."""
    looks, goes_on = threading.Event(), threading.Event()
    look = NearDuplicates.of

    def held(self: NearDuplicates, name: str, *said: Any, **how: Any) -> ViewRecord | None:
        looks.set()
        assert goes_on.wait(30)
        return look(self, name, *said, **how)

    with CheckedClient(create_app(build(settings(tmp_path, compare=False)))) as client:
        assert client.put("/maps/wall", json={}).status_code == 201
        assert client.patch("/maps/wall", json={"refuse_poor": True}).status_code == 200
        assert client.post("/enroll?map=wall", content=wall(92), headers=JPEG).status_code == 201
        monkeypatch.setattr(NearDuplicates, "of", held)
        with ThreadPoolExecutor(1) as caller:
            first = caller.submit(client.post, "/enroll?map=wall", content=wall(70), headers=JPEG)
            assert looks.wait(30)
            told = client.post("/enroll?map=wall&wait=false", content=wall(70), headers=JPEG)
            goes_on.set()
            refused = first.result(30)

        assert told.status_code == 202
        assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:poor-picture")
        view = settled(client, told.json()["view"]["id"])
        assert (view["state"], view["failure"]["code"]) == ("failed", "poor-picture")
        assert client.get(f"/jobs/{told.json()['job']}").json()["state"] == "failed"


def test_an_import_lists_what_the_map_refuses_once_it_is_described(client: httpx.Client) -> None:
    assert client.put("/maps/stop-and-go", json={}).status_code == 201
    assert client.patch("/maps/stop-and-go", json={"refuse_poor": True}).status_code == 200
    files = {"0.jpg": wall(92), "1.jpg": wall(70), "2.png": crowd(0.9, 2), "3.jpg": sharp(4), "4.jpg": wall(60)}

    for enrolled, there in ((2, 0), (0, 2)):
        answer = client.post("/maps/stop-and-go/imports", content=zipped(files), headers=ZIP)
        result = ended(client, answer.json()["id"])["result"]

        assert (result["enrolled"], result["already_there"], result["failed"]) == (enrolled, there, 3)
        assert [(one["file"], one["problem"]) for one in result["errors"]] == [
            (file, "poor-picture") for file in ("1.jpg", "2.png", "4.jpg")
        ]
        assert "adds nothing" in result["errors"][0]["detail"]
        views = client.get("/views?map=stop-and-go").json()["views"]
        assert sorted(view["filename"] for view in views) == ["0.jpg", "3.jpg"]  # nothing else is left


def test_an_import_removes_no_view_that_somebody_else_enrolled_meanwhile(client: httpx.Client) -> None:
    """The view is refused, its id was told, and the import comes to the same image later."""
    poor = crowd(0.9, 2)
    files = {**{f"{i:02}.jpg": sharp(i) for i in range(40)}, "99.jpg": poor}
    job = client.post("/maps/lot/imports?refuse_poor=true", content=zipped(files), headers=ZIP).json()

    told = client.post("/enroll?map=lot&refuse_poor=true&wait=false", content=poor, headers=JPEG)

    assert told.status_code == 202
    assert settled(client, told.json()["view"]["id"])["failure"]["code"] == "poor-picture"
    assert client.get(f"/jobs/{job['id']}").json()["state"] == "running", "it had come to the image before"
    [error] = ended(client, job["id"])["result"]["errors"]
    assert (error["file"], error["problem"]) == ("99.jpg", "poor-picture")
    view = client.get(f"/views/{told.json()['view']['id']}").json()
    assert (view["state"], view["failure"]["code"]) == ("failed", "poor-picture")
    assert f"kept as view {view['id']}" in error["detail"]
