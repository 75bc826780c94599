"""A home robot may know its rooms, but keep no photo of them: it recognises and explains without any."""

import io
import signal
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from PIL import Image as PilImage

from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import RunningService
from tests.waiting import until

JPEG = {"content-type": "image/jpeg"}
ROOMS = ("mill lane", "station road", "rose garden", "market street")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, database: str) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[httpx.Client]:
    with (
        RunningService(data, REVISIT_ENCODER="compact") as service,
        httpx.Client(base_url=service.url, timeout=60) as one,
    ):
        one.put("/maps/home", json={})
        told = one.patch("/maps/home", json={"keep_images": False})
        assert told.json()["keep_images"] is False
        for name in ROOMS:
            for turn in (0, 4):
                look = photo(scene(name).seen_from(turn=turn))
                answer = one.post(f"/enroll?map=home&place={name}", content=look, headers=JPEG)
                assert answer.json()["view"]["state"] == "ready"
        yield one


def kept(data: Path) -> list[Path]:
    return [path for path in data.glob("pictures/*/*/*") if path.is_file()]


def test_no_photo_lies_in_the_data_folder(client: httpx.Client, data: Path) -> None:
    assert kept(data) == []
    everything = b"".join(path.read_bytes() for path in data.rglob("*") if path.is_file())
    first = photo(scene(ROOMS[0]).seen_from(turn=0))
    assert first[200:400] not in everything
    assert client.get("/maps/home").json()["bytes"] == 0


def test_a_room_is_recognised_and_explained_all_the_same(client: httpx.Client) -> None:
    taken = photo(scene("mill lane").seen_from(dx=0.3, turn=-2))
    answer = client.post("/query?map=home&explain=true", content=taken, headers=JPEG).json()
    assert (answer["status"], answer["places"][0]["place"]) == ("matched", "mill lane")
    drawn = client.get(f"/queries/{answer['query']['id']}/explanation.png")
    assert drawn.status_code == 200
    with PilImage.open(io.BytesIO(drawn.content)) as sheet:
        assert sheet.width > 600


def test_what_would_show_the_photo_says_that_it_is_not_kept(client: httpx.Client) -> None:
    view = client.get("/views?map=home").json()["views"][0]["id"]
    for name in ("image", "thumbnail", "segmentation.png", "graph.png"):
        refused = client.get(f"/views/{view}/{name}")
        assert (refused.status_code, refused.json()["type"]) == (404, "urn:revisit:problem:image-not-kept"), name
    for path, body in (("/maps/home/vocabulary", None), ("/maps/home/recipe", {"labels": ["wall", "floor"]})):
        refused = client.post(path, json=body)
        assert (refused.status_code, refused.json()["type"]) == (409, "urn:revisit:problem:conflict"), refused.text
    back = client.patch("/maps/home", json={"keep_images": True})
    assert (back.status_code, "gone" in back.json()["detail"]) == (409, True)


def test_images_that_were_kept_are_removed_when_the_map_is_changed(client: httpx.Client, data: Path) -> None:
    for name in ROOMS[:2]:
        client.post(f"/enroll?map=flat&place={name}", content=photo(scene(name).seen_from()), headers=JPEG)
    assert len(kept(data)) == 2
    one, other = (view["id"] for view in client.get("/views?map=flat").json()["views"])
    shown = {
        path: client.get(path).headers["etag"]
        for path in (
            *(f"/views/{one}/{name}" for name in ("image", "thumbnail", "segmentation.png", "graph.png")),
            f"/views/{one}/changes.png?since={other}",
        )
    }
    for path, etag in shown.items():
        assert client.get(path, headers={"if-none-match": etag}).status_code == 304
    assert client.patch("/maps/flat", json={"keep_images": False}).status_code == 200
    assert kept(data) == []
    for path, etag in shown.items():  # a cache that asks is not told that its copy is current
        assert client.get(path, headers={"if-none-match": etag}).status_code == 404, path


def test_a_kill_between_description_and_removal_leaves_nothing_after_the_next_start(tmp_path: Path) -> None:
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as one:
        one.put("/maps/home", json={})
        one.patch("/maps/home", json={"keep_images": False})
        images = [("image", (f"{n}.jpg", photo(scene(f"room {n}").seen_from()), "image/jpeg")) for n in range(4)]
        one.post("/enroll?map=home&wait=false", files=images)
        service.signal(signal.SIGKILL)
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as one:
        until(lambda: one.get("/maps/home").json()["views"]["pending"] == 0)
    with RunningService(tmp_path):
        assert kept(tmp_path) == []
