"""An image on disk is damaged: no call serves it, its view is found all the same, and enrolling it again heals it."""

import logging
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from app.http.application import create_app
from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import settings
from worker.runtime import build

pytestmark = pytest.mark.one_database("images lie in a folder, whatever the database is")

JPEG = {"content-type": "image/jpeg"}
NAMES = ("mill lane", "rose garden")


def flip(path: Path) -> None:
    body = bytearray(path.read_bytes())
    body[len(body) // 2] ^= 1
    path.write_bytes(body)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "flipped": flip,
    "emptied": lambda path: path.write_bytes(b""),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-2]),
    "missing": Path.unlink,
}


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(build(settings(tmp_path, compare=False)))) as client:
        yield client


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_image(kind: str, client: TestClient, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ids = []
    for name in NAMES:
        answer = client.post(f"/enroll?map=town&place={name}", content=photo(scene(name)), headers=JPEG)
        ids.append(answer.json()["view"]["id"])
    digest = client.get(f"/views/{ids[0]}").json()["image"]["sha256"]
    DAMAGES[kind](tmp_path / "pictures" / digest[:2] / digest[2:4] / digest)

    for call in ("image", "thumbnail", "segmentation.png", "graph.png"):
        with caplog.at_level(logging.ERROR):
            answer = client.get(f"/views/{ids[0]}/{call}")
        assert (answer.status_code, answer.json()["type"]) == (500, "urn:revisit:problem:damaged"), call
        assert "enrol the image again" in answer.json()["detail"]
        assert f"view {ids[0]}" in caplog.text
        assert "Traceback" not in caplog.text
    assert client.get(f"/views/{ids[1]}/image").status_code == 200
    found = client.post("/query?map=town", content=photo(scene(NAMES[0])), headers=JPEG).json()
    assert found["matches"][0]["view"]["id"] == ids[0]

    again = client.post(f"/enroll?map=town&place={NAMES[0]}", content=photo(scene(NAMES[0])), headers=JPEG)
    assert again.status_code == 200
    assert client.get(f"/views/{ids[0]}/image").content == photo(scene(NAMES[0]))
