"""Views are known by the file names they came with, and looked for in the frame in which their map is measured."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.values import LONGEST_FILE_NAME, file_name
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded, exif_of_a_phone
from tests.stories.photos import photo
from tests.stories.running import settings
from worker.runtime import build

JPEG = {"headers": {"content-type": "image/jpeg"}}


@pytest.fixture
def client(tmp_path: Path) -> Iterator[CheckedClient]:
    with CheckedClient(create_app(build(settings(tmp_path)))) as client:
        yield client


def test_a_photo_is_shown_by_the_name_it_was_sent_with(client: CheckedClient) -> None:
    lane, green = photo(scene("mill lane").seen_from()), photo(scene("the green").seen_from())
    part = client.post("/enroll", files={"image": ("C:\\photos\\lane 1.jpg", lane)}).json()["view"]
    raw = client.post("/enroll?filename=/sdcard/DCIM/IMG_7.jpg", content=green, **JPEG).json()["view"]
    nameless = client.post("/enroll", content=photo(scene("chapel row").seen_from()), **JPEG).json()["view"]
    assert [part["filename"], raw["filename"], nameless["filename"]] == ["lane 1.jpg", "IMG_7.jpg", None]

    again = client.post("/enroll", files={"image": ("copy.jpg", lane)})
    assert (again.status_code, again.json()["view"]["filename"]) == (200, "lane 1.jpg")
    assert client.patch(f"/views/{part['id']}", json={"place": "lane"}).json()["filename"] == "lane 1.jpg"
    assert [view["filename"] for view in client.get("/views").json()["views"]] == ["lane 1.jpg", "IMG_7.jpg", None]
    found = client.post("/query", content=green, **JPEG).json()["matches"][0]["view"]
    assert found["filename"] == "IMG_7.jpg"


def test_exif_says_where_and_when_a_photo_was_taken_if_that_is_wanted(client: CheckedClient) -> None:
    def enrolled(seed: int, **fields: str) -> dict[str, Any]:
        files = {"image": ("a.jpg", encoded(drawn(64, 48, seed), "jpeg", exif=exif_of_a_phone()))}
        view: dict[str, Any] = client.post("/enroll", files=files, data=fields).json()["view"]
        return {name: value for name, value in (view["position"] or {}).items() if value is not None} | {
            "captured_at": view["captured_at"]
        }

    moment = {"captured_at": "2026-05-04T09:30:00.000000Z"}
    assert enrolled(1) == {"captured_at": None}
    assert enrolled(2, exif="true") == {"lat": -27.4, "lon": 153.0, "heading": 90.0} | moment
    given = {"lat": "-27.5", "lon": "153.1", "captured_at": "2026-01-01T00:00:00Z"}
    said = {"lat": -27.5, "lon": 153.1, "captured_at": "2026-01-01T00:00:00.000000Z"}
    assert enrolled(3, exif="true", **given) == said
    assert enrolled(4, exif="true", x="1", y="2", map="metric") == {"x": 1.0, "y": 2.0} | moment


def test_several_photos_have_the_names_of_their_parts(client: CheckedClient) -> None:
    looks = [photo(scene(name).seen_from()) for name in ("mill lane", "the green")]
    files = [("image", (f"{number}.jpg", look)) for number, look in enumerate(looks)]
    refused = client.post("/enroll", files=files, data={"filename": "both.jpg"})
    assert (refused.status_code, refused.json()["errors"][0]["parameter"]) == (422, "filename")
    views = client.post("/enroll", files=files).json()["views"]
    assert [one["view"]["filename"] for one in views] == ["0.jpg", "1.jpg"]


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("a.jpg", "a.jpg"),
        ("../../etc/passwd", "passwd"),
        ("C:\\a\\b.png", "b.png"),
        ("a\nb\x1b[2J\x7f.jpg", "ab[2J.jpg"),
        ("photo\u202egpj.exe", "photogpj.exe"),
        ("Straße 東京.jpg", "Straße 東京.jpg"),
        ("folder/", None),
        ("..", None),
        ("", None),
        (None, None),
        ("\ud800", None),
        ("n" * 300 + ".jpeg", "n" * (LONGEST_FILE_NAME - 6) + "….jpeg"),
        ("." + "n" * 300, "." + "n" * (LONGEST_FILE_NAME - 2) + "…"),
    ],
)
def test_a_name_is_cleaned(sent: str | None, kept: str | None) -> None:
    assert file_name(sent) == kept
    assert kept is None or len(kept) <= LONGEST_FILE_NAME


def test_near_is_in_the_frame_of_the_map(client: CheckedClient) -> None:
    def enroll(name: str, **where: float) -> None:
        client.post("/enroll", params={**where, "place": name}, content=photo(scene(name).seen_from()), **JPEG)

    def near(text: str, **more: str) -> list[str]:
        answer = client.get("/views", params={"map": "default", "near": text, **more})
        assert answer.status_code == 200, answer.text
        return [view["place"] for view in answer.json()["views"]]

    enroll("mill lane", lat=-27.4, lon=153.0, heading=360)
    enroll("the green", lat=-27.5, lon=153.0)
    assert near("-27.4,153.0,50") == ["mill lane"] == near("-27.4,153.0,50", frame="geo")
    assert near("-27.4,153.0,50", frame="map") == []
    assert client.get("/views?place=mill lane").json()["views"][0]["position"]["heading"] == 0
    outside = client.get("/views?map=default&near=153.0,-27.4,50")
    assert (outside.status_code, outside.json()["errors"][0]["parameter"]) == (422, "near")

    enroll("chapel row", x=-27.4, y=153.0)
    mixed = client.get("/views?map=default&near=-27.4,153.0,50")
    assert (mixed.status_code, mixed.json()["errors"][0]["parameter"]) == (422, "frame")
    assert near("-27.4,153.0,50", frame="map") == ["chapel row"]
    answer = client.post("/query?near=-27.4,153.0,50&frame=geo", content=photo(scene("the green").seen_from()), **JPEG)
    assert [match["view"]["place"] for match in answer.json()["matches"]] == ["mill lane"]


@pytest.mark.parametrize("path", ["/views/{}", "/maps/{}", "/views?{}=1", "/{}", "/views?map={}", "/jobs/{}"])
def test_a_refusal_does_not_repeat_an_oversized_name(client: CheckedClient, path: str) -> None:
    answer = client.get(path.format("n" * 5000))
    assert answer.status_code in (404, 422)
    assert len(answer.content) < 1500
