"""A shop may photograph the street, but not keep who walks there: what is kept is blurred, and places are found."""

import io
import resource
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from PIL import Image as PilImage

from schemas.image import Bytes2D
from tests.stories.photos import jpeg
from tests.stories.running import RunningService
from worker.encoders.color import COLORS

JPEG = {"content-type": "image/jpeg"}
MARK = (250, 90, 140)
"""Colour of people, to the encoder that takes colours for labels."""


def street(seed: int, *, people: int = 1) -> Bytes2D:
    """A drawn street in the encoder's colours, another for each seed, with people of another texture each."""
    draw = np.random.default_rng(seed)
    pixels = np.zeros((240, 320, 3), np.uint8)
    pixels[:90], pixels[90:170], pixels[170:] = COLORS["sky"], COLORS["building"], COLORS["road"]
    for _ in range(12):
        left, top = draw.integers(0, 280), draw.integers(20, 150)
        label = str(draw.choice(["vegetation", "trunk", "pole", "sidewalk", "terrain"]))
        pixels[top : top + draw.integers(20, 60), left : left + draw.integers(10, 40)] = COLORS[label]
    pixels = np.clip(pixels + draw.normal(0, 4, pixels.shape), 0, 255).astype(np.uint8)
    for number in range(people):
        first = 40 + 90 * number
        pixels[100:220, first : first + 50] = MARK
    return pixels


def is_seen(data: bytes) -> bool:
    """Whether an image shows people."""
    with PilImage.open(io.BytesIO(data)) as opened:
        pixels = np.asarray(opened.convert("RGB")).astype(int)
    return bool((np.abs(pixels - MARK).max(axis=-1) < 25).mean() > 0.001)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, database: str) -> Path:
    return tmp_path_factory.mktemp("shop")


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[httpx.Client]:
    with RunningService(data) as service, httpx.Client(base_url=service.url, timeout=60) as one:
        one.put("/maps/shop", json={})
        told = one.patch("/maps/shop", json={"blur": ["People", "vehicles", "people"], "keep_queries": 50})
        assert told.json()["blur"] == ["people", "vehicles"]
        yield one


def enrol(client: httpx.Client, image: bytes, **said: str) -> httpx.Response:
    return client.post("/enroll", params={"map": "shop", **said}, content=image, headers=JPEG)


def kept(data: Path) -> list[Path]:
    return [path for path in data.glob("pictures/*/*/*") if path.is_file()]


def test_what_is_kept_and_served_shows_nobody(client: httpx.Client, data: Path) -> None:
    image = jpeg(street(1))
    assert is_seen(image)
    answer = enrol(client, image, place="one").json()
    assert answer["view"]["state"] == "ready"
    view = answer["view"]["id"]
    assert not any(is_seen(path.read_bytes()) for path in kept(data))
    for name in ("image", "thumbnail"):
        assert not is_seen(client.get(f"/views/{view}/{name}").content)
    [labels] = [client.get("/maps/shop").json()["labels"]]
    people = {label["index"] for label in labels if label["label"] == "cyclist"}
    with PilImage.open(io.BytesIO(client.get(f"/views/{view}/segmentation.png").content)) as drawn:
        assert (np.isin(np.asarray(drawn), list(people))).mean() < 0.01
    everything = b"".join(path.read_bytes() for path in data.rglob("*") if path.is_file())
    assert image[len(image) // 2 :][:200] not in everything


class Debugged(RunningService):
    """A service whose shell has it write a core file when it crashes."""

    within = "sh", "-c", 'ulimit -S -c "$(ulimit -H -c)"; exec "$@"', "sh"


@pytest.mark.skipif(sys.platform != "linux", reason="limits of other processes are read on Linux")
def test_a_crash_writes_no_core_file_with_what_was_sent(tmp_path: Path) -> None:
    with Debugged(tmp_path) as service:
        least, most = resource.prlimit(service.pid, resource.RLIMIT_CORE)
        assert (least, most) == (0, resource.getrlimit(resource.RLIMIT_CORE)[1])


def test_the_same_image_again_is_the_same_view_and_is_found(client: httpx.Client) -> None:
    image = jpeg(street(2))
    first = enrol(client, image, place="two")
    again = enrol(client, image, place="two")
    assert (first.status_code, again.status_code) == (201, 200)
    assert again.json()["view"]["id"] == first.json()["view"]["id"]
    assert enrol(client, image, place="elsewhere").status_code == 409
    stored = client.get(f"/views/{first.json()['view']['id']}/image").content
    assert enrol(client, stored, place="two").json()["created"] is False
    answer = client.post("/query?map=shop", content=jpeg(street(2, people=0)), headers=JPEG).json()
    assert answer["matches"][0]["view"]["place"] == "two"


def test_an_image_without_people_is_written_anew_too(client: httpx.Client) -> None:
    """Only what was segmented is kept: metadata, and the small image in it, may show what the photo does not."""
    buffer = io.BytesIO()
    exif = PilImage.Exif()
    exif[0x010E] = "who was here"
    PilImage.fromarray(street(3, people=0)).save(buffer, "JPEG", quality=92, exif=exif)
    view = enrol(client, buffer.getvalue()).json()["view"]
    assert view["image"]["format"] == "jpeg"
    assert b"who was here" in buffer.getvalue()
    assert b"who was here" not in client.get(f"/views/{view['id']}/image").content


def test_an_image_of_people_alone_is_refused_and_leaves_nothing(client: httpx.Client, data: Path) -> None:
    before = len(kept(data))
    crowd = np.full((240, 320, 3), MARK, np.uint8)
    refused = enrol(client, jpeg(crowd))
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:nothing-static")
    assert len(kept(data)) == before


def test_kept_queries_show_nobody(client: httpx.Client) -> None:
    strange = np.ascontiguousarray(street(77)[::-1])
    answer = client.post("/query?map=shop", content=jpeg(strange), headers=JPEG).json()
    assert answer["status"] == "no_match", "in a map of three views no answer is sure"
    places = client.get("/maps/shop/unknown").json()["places"]
    [place] = [one for one in places if answer["query"]["id"] in one["queries"]]
    image = client.get(f"/maps/shop/unknown/{place['id']}/image").content
    assert is_seen(jpeg(strange))
    assert not is_seen(image)
    named = client.post(f"/maps/shop/unknown/{place['id']}", json={"place": "backyard"}).json()
    view = named["views"][0]
    while view["state"] == "pending":
        time.sleep(0.02)
        view = client.get(f"/views/{view['id']}").json()
    assert (view["state"], is_seen(client.get(f"/views/{view['id']}/image").content)) == ("ready", False)


def test_imports_are_blurred_and_their_archive_does_not_stay(client: httpx.Client, data: Path) -> None:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as files:
        for seed in (11, 12):
            files.writestr(f"{seed}.jpg", jpeg(street(seed, people=2)))
    for expected in ((2, 0), (0, 2)):
        job = client.post(
            "/maps/shop/imports", content=archive.getvalue(), headers={"content-type": "application/zip"}
        ).json()
        while job["state"] not in ("done", "failed"):
            time.sleep(0.05)
            job = client.get(f"/jobs/{job['id']}").json()
        assert (job["result"]["enrolled"], job["result"]["already_there"]) == expected
    assert not any(is_seen(path.read_bytes()) for path in kept(data))
    assert not [path for path in data.rglob("*") if path.is_file() and path.read_bytes()[:2] == b"PK"]


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"blur": ["nonsense"]}, 422),
        ({"blur": [""]}, 422),
        ({"blur": "people"}, 422),
        ({"blur": [1]}, 422),
        ({"blur": [f"w{n}" for n in range(21)]}, 422),
        ({"blur": ["people", "building"]}, 409),
    ],
)
def test_what_cannot_be_blurred_is_refused(client: httpx.Client, body: dict[str, object], status: int) -> None:
    enrol(client, jpeg(street(5)))
    assert client.patch("/maps/shop", json=body).status_code == status


def test_of_changes_of_which_one_is_refused_none_is_made(client: httpx.Client) -> None:
    enrol(client, jpeg(street(5)))
    settings = "ranking", "blur", "keep_images", "keep_queries", "keep_matches", "refuse_poor"
    before = client.get("/maps/shop").json()
    changes = {"ranking": {"candidates": 33}, "keep_queries": 9, "refuse_poor": True, "blur": ["people", "building"]}

    assert client.patch("/maps/shop", json=changes).status_code == 409

    after = client.get("/maps/shop").json()
    assert {name: after[name] for name in settings} == {name: before[name] for name in settings}
    wrong = client.patch("/maps/shop", json={"ranking": {"candidates": -1, "colour": 1}, "blur": ["nonsense"]})
    assert [error["parameter"] for error in wrong.json()["errors"]] == ["blur", "ranking.candidates", "ranking.colour"]


def test_words_that_were_given_up_are_not_taken_back_while_there_are_views(client: httpx.Client) -> None:
    client.put("/maps/stall", json={})
    assert client.patch("/maps/stall", json={"blur": ["people", "vehicles"]}).status_code == 200
    assert client.post("/enroll", params={"map": "stall"}, content=jpeg(street(6)), headers=JPEG).status_code == 201

    assert client.patch("/maps/stall", json={"blur": ["people"]}).status_code == 200
    assert client.patch("/maps/stall", json={"blur": ["people", "vehicles"]}).status_code == 409


def test_a_kill_while_enrolling_leaves_nobody_on_the_disk(tmp_path: Path) -> None:
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as one:
        one.put("/maps/shop", json={})
        one.patch("/maps/shop", json={"blur": ["people"]})
        for seed in range(20, 26):
            one.post("/enroll?map=shop&wait=false", content=jpeg(street(seed)), headers=JPEG)
        service.kill()
    assert kept(tmp_path)
    assert not any(is_seen(path.read_bytes()) for path in kept(tmp_path))
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as one:
        again = one.post("/enroll?map=shop", content=jpeg(street(20)), headers=JPEG).json()
        assert (again["created"], again["view"]["state"]) == (False, "ready")
        assert one.get("/maps/shop").json()["views"]["failed"] == 0
    assert not any(is_seen(path.read_bytes()) for path in kept(tmp_path))


def test_people_in_an_image_of_any_form_are_covered_where_they_stand(client: httpx.Client) -> None:
    pixels = cv2.copyMakeBorder(street(9), 0, 200, 0, 0, cv2.BORDER_REPLICATE)
    view = enrol(client, jpeg(pixels)).json()["view"]
    assert (view["image"]["width"], view["image"]["height"]) == (320, 440)
    assert not is_seen(client.get(f"/views/{view['id']}/image").content)
