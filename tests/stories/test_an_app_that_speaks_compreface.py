"""An app written for CompreFace changes its base URL; its client's requests, as that sends them, are answered.

The requests are those of CompreFace's own Python client, compreface-sdk 0.6.0: parameters after ``?&``, the key in
``x-api-key``, images as the part ``file`` without a content type, texts as JSON. The answers have the fields of
CompreFace's REST API (docs/Rest-API-description.md of its repository).
"""

import base64
import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import ROOT, RunningService
from tests.stories.shown import answers_of

BOUNDARY = "c0ffee5f1d0c4a3f8a0e6a5ad6b0c1d2"
TOWNS = count(1)


class App:
    """Sends what CompreFace's client sends."""

    def __init__(self, client: httpx.Client, name: str) -> None:
        self.base = f"/compat/compreface/{name}/api/v1/recognition"
        self.client = client

    def image(self, path: str, image: bytes) -> httpx.Response:
        """POST an image."""
        body = (
            f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="file"; filename="image.jpg"\r\n\r\n'.encode()
            + image
            + f"\r\n--{BOUNDARY}--\r\n".encode()
        )
        headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        return self.client.post(self.base + path, content=body, headers=headers)

    def json(self, method: str, path: str, body: Any = None) -> httpx.Response:
        """Any other request: its client always names JSON as the type of the body."""
        content = None if body is None else json.dumps(body)
        headers = {"Content-Type": "application/json"}
        return self.client.request(method, self.base + path, content=content, headers=headers)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("towns")) as one:
        yield one


@pytest.fixture
def app(service: RunningService) -> Iterator[App]:
    key = {"x-api-key": "none is asked for"}
    with httpx.Client(base_url=service.url, headers=key, timeout=30) as client:
        app = App(client, f"town-{next(TOWNS)}")
        for number in range(3):
            for taken in range(2):
                added = app.image(f"/faces?subject=gate {number}&det_prob_threshold=0.8", photo(10 * number + taken))
                assert added.status_code == 201, added.text
                assert added.json().keys() == {"image_id", "subject"}
        yield app


def subjects(app: App) -> list[str]:
    listed: list[str] = app.json("GET", "/subjects").json()["subjects"]
    return listed


def test_a_place_is_recognised(app: App) -> None:
    answer = app.image("/recognize?&limit=0&det_prob_threshold=0.8&prediction_count=2&status=true", photo(10)).json()
    [result] = answer["result"]
    assert result["box"] == {"probability": 1.0, "x_min": 0, "y_min": 0, "x_max": 64, "y_max": 48}
    assert result["subjects"][0]["subject"] == "gate 1"
    assert len(result["subjects"]) <= 2
    assert 0 <= result["subjects"][-1]["similarity"] <= result["subjects"][0]["similarity"] <= 1
    assert (result["status"], result["reason"]) in {("matched", "sure"), ("ambiguous", "look-alike")}
    assert result["execution_time"]["total"] > 0
    assert answer["plugins_versions"].keys() == {"revisit"}

    in_base64 = app.json("POST", "/recognize", {"file": base64.b64encode(photo(10)).decode()}).json()
    assert in_base64["result"][0]["subjects"] == result["subjects"][:1]
    assert in_base64.keys() == {"result"}  # nobody wanted the status
    assert in_base64["result"][0].keys() == {"status", "reason", "box", "subjects"}


def test_an_image_is_verified_against_an_example(app: App) -> None:
    ids = {one["subject"]: one["image_id"] for one in app.json("GET", "/faces").json()["faces"]}
    similar = {
        name: app.image(f"/faces/{image_id}/verify?&status=True", photo(10)).json()["result"][0]
        for name, image_id in ids.items()
    }
    assert similar["gate 1"]["similarity"] == max(one["similarity"] for one in similar.values()) > 0
    plain = app.image(f"/faces/{ids['gate 1']}/verify", photo(10)).json()
    assert (plain.keys(), plain["result"][0].keys()) == (
        {"result"},
        {"status", "reason", "box", "subject", "similarity"},
    )
    assert {name: one["subject"] for name, one in similar.items()} == {name: name for name in ids}
    assert sum(one["similarity"] for one in similar.values()) <= 1


def test_examples_are_listed_shown_and_deleted(app: App) -> None:
    page = app.json("GET", "/faces?page=1&size=4").json()
    assert [one["subject"] for one in page.pop("faces")] == ["gate 2", "gate 2"]
    assert page == {"page_number": 1, "page_size": 4, "total_pages": 2, "total_elements": 6}
    mine = app.json("GET", "/faces?subject=gate 1").json()
    assert (mine["total_elements"], len(mine["faces"])) == (2, 2)

    first, second = (one["image_id"] for one in mine["faces"])
    shown = app.json("GET", f"/faces/{first}/img")
    assert (shown.content, shown.headers["content-type"]) == (photo(10), "image/jpeg")
    assert app.json("DELETE", f"/faces/{first}").json() == {"image_id": first, "subject": "gate 1"}
    assert app.json("DELETE", f"/faces/{first}").status_code == 404
    assert app.json("DELETE", "/faces?subject=gate 1").json() == {"deleted": 1}
    assert app.json("GET", f"/faces/{second}/img").status_code == 404
    assert app.json("DELETE", "/faces").json() == {"deleted": 4}
    assert app.json("GET", "/faces").json()["faces"] == []


def test_subjects_are_renamed_merged_and_deleted(app: App) -> None:
    assert subjects(app) == ["gate 0", "gate 1", "gate 2"]
    assert app.json("POST", "/subjects", {"subject": "gate 9"}).json() == {"subject": "gate 9"}
    assert "gate 9" not in subjects(app)  # it has no example yet
    # Its client sends the old name along in the body.
    renamed = app.json("PUT", "/subjects/gate 1", {"api_endpoint": "gate 1", "subject": "gate 2"})
    assert renamed.json() == {"updated": True}
    assert app.json("GET", "/faces?subject=gate 2").json()["total_elements"] == 4
    assert app.json("PUT", "/subjects/gate 1", {"subject": "gate 2"}).json() == {"updated": False}
    assert app.json("PUT", "/subjects/gate 2", {"subject": "yard/gate 2"}).json() == {"updated": True}
    assert app.json("PUT", "/subjects/yard%2Fgate 2", {"subject": "yard/gate%2F"}).json() == {"updated": True}
    assert app.json("PUT", "/subjects/yard/gate%252F", {"subject": "gate 2"}).json() == {"updated": True}
    assert app.json("DELETE", "/subjects/gate 2").json() == {"subject": "gate 2"}
    assert app.json("DELETE", "/subjects/gate 2").status_code == 404
    assert subjects(app) == ["gate 0"]
    assert app.json("DELETE", "/subjects").json() == {"deleted": 1}
    assert subjects(app) == []


def test_the_calls_of_the_page_work_and_an_image_is_an_example_of_one_subject(app: App, tmp_path: Path) -> None:
    (tmp_path / "gate.jpg").write_bytes(photo(1))
    (tmp_path / "today.jpg").write_bytes(photo(1))
    url = str(app.client.base_url).rstrip("/")
    added, found = (json.loads(answer) for answer in answers_of(ROOT / "docs" / "compreface.md", tmp_path, url))
    assert added["subject"] == "gate"
    assert found["result"][0]["subjects"][0]["subject"] == "gate"

    campus = App(app.client, "campus")
    again, other = (campus.image(f"/faces?subject={subject}", photo(1)) for subject in ("gate", "quay"))
    assert (again.status_code, again.json()) == (201, added)
    assert other.status_code == 409


def test_a_base_url_without_a_map_means_the_default_one(app: App) -> None:
    bare = App(app.client, "")
    bare.base = "/compat/compreface/api/v1/recognition"
    assert bare.json("GET", "/subjects/").status_code == 404  # there is no map yet
    added = bare.image("/faces?subject=gate", photo(1)).json()
    assert bare.json("GET", "/subjects/").json() == {"subjects": ["gate"]}
    assert app.client.get(f"/views/{added['image_id']}").json()["map"] == "default"
    named = App(app.client, "api")
    assert named.image("/faces?subject=quay", photo(2)).status_code == 201
    assert (subjects(named), subjects(bare)) == (["quay"], ["gate"])


def test_all_examples_come_on_one_page(app: App) -> None:
    page = app.json("GET", "/faces?size=10000").json()
    assert (len(page["faces"]), page["total_pages"]) == (6, 1)


def test_what_is_wrong_is_said(app: App) -> None:
    image_id = app.json("GET", "/faces").json()["faces"][0]["image_id"]
    attic = App(app.client, "attic")
    for answer, status, kind in (
        (app.image("/recognize", b"no image"), 415, "not-a-picture"),
        (app.json("POST", "/recognize", {"file": "?"}), 422, "invalid-parameter"),
        (app.json("POST", "/recognize", {}), 422, "invalid-parameter"),
        (app.image("/recognize?limit=-1", photo()), 422, "invalid-parameter"),
        (app.image("/recognize?colour=red", photo()), 422, "invalid-parameter"),
        (app.image("/faces", photo()), 422, "invalid-parameter"),
        (app.json("POST", "/subjects", {"subject": ""}), 422, "invalid-parameter"),
        (app.json("POST", "/subjects", {"subject": 5}), 422, "invalid-parameter"),
        (app.json("PUT", "/subjects/gate 1", [1]), 400, "malformed-body"),
        (attic.image("/recognize", photo()), 404, "not-found"),
        (attic.json("GET", f"/faces/{image_id}/img"), 404, "not-found"),
        (attic.json("DELETE", f"/faces/{image_id}"), 404, "not-found"),
    ):
        assert (answer.status_code, answer.json()["type"].rpartition(":")[2]) == (status, kind), answer.text
        assert answer.json()["message"] == answer.json()["detail"]  # which is what clients of CompreFace show
    answer = app.client.post(f"{app.base}/recognize", files={"file": photo()}, data={"more": "1"})
    assert [error["parameter"] for error in answer.json()["errors"]] == ["more"]
