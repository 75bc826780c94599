"""The map was made with one camera, and a robot queries with another, which sees less of a place, or more."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.image import Bytes2D, Image
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg, middle, photo
from worker.images.framing import framed
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how a query is compared, not where views lie")

JPEG = {"content-type": "image/jpeg"}
STEPS = (0.0, 2.0, 4.0, 6.0)
STREET = scene("mill lane")


@pytest.fixture
def client(tmp_path: Path) -> Iterator[CheckedClient]:
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        yield client


def query(client: CheckedClient, pixels: Bytes2D, **parameters: Any) -> dict[str, Any]:
    answer = client.post("/query", content=jpeg(pixels), params=parameters, headers=JPEG)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def enroll(client: CheckedClient, place: str, image: bytes) -> None:
    client.post("/enroll", params={"place": place}, content=image, headers=JPEG).raise_for_status()


def test_a_narrower_camera_that_says_so_is_found_where_it_stands(client: CheckedClient) -> None:
    for ahead in STEPS:
        enroll(client, f"{ahead:g}", photo(STREET.seen_from(ahead=ahead)))
    plain, told = [], []
    for ahead in STEPS:
        taken = middle(STREET.seen_from(dx=0.5, ahead=ahead, turn=3).at("overcast").pixels, 1 / 1.5)
        plain.append(query(client, taken)["matches"][0])
        told.append(query(client, taken, zoom=1.5)["matches"][0])

    # The middle of what is seen here is what is seen further on.
    assert [match["view"]["place"] for match in plain] == ["2", "4", "6", "6"]
    assert [match["view"]["place"] for match in told] == ["0", "2", "4", "6"]
    assert all(0.9 < match["dense"]["scale"] < 1.15 for match in told)


def test_a_wider_camera_is_compared_by_what_the_maps_camera_would_have_seen(client: CheckedClient) -> None:
    for ahead in STEPS:
        enroll(client, f"{ahead:g}", jpeg(middle(STREET.seen_from(ahead=ahead).pixels, 0.625)))
    taken = STREET.seen_from(dx=0.5, ahead=2, turn=3).at("overcast").pixels
    told = query(client, taken, zoom=0.625)

    assert told["matches"][0]["view"]["place"] == "2"
    assert 0.9 < told["matches"][0]["dense"]["scale"] < 1.15
    assert (told["query"]["width"], told["query"]["height"]) == (taken.shape[1], taken.shape[0])


def test_what_another_camera_sees_is_kept_nowhere(client: CheckedClient) -> None:
    enroll(client, "mill lane", photo(STREET))
    client.patch("/maps/default", json={"keep_queries": 10, "keep_matches": 10}).raise_for_status()
    elsewhere = scene("north corridor").pixels
    for other in ({"zoom": 0.8}, {"zoom": 1.5}, {"roll": 10}):
        assert query(client, elsewhere, **other)["status"] == "no_match"
    assert client.get("/maps/default/unknown").json()["places"] == []
    assert query(client, elsewhere)["status"] == "no_match"
    assert len(client.get("/maps/default/unknown").json()["places"]) == 1


@pytest.mark.parametrize("zoom", [0.7, 1.4])
def test_it_is_explained_as_it_was_compared_and_changes_are_looked_for_in_the_photo(
    client: CheckedClient, zoom: float
) -> None:
    enroll(client, "mill lane", photo(STREET))
    enroll(client, "rose garden", photo(scene("rose garden")))
    taken = middle(STREET.seen_from(dx=0.2).pixels, 1 / zoom) if zoom > 1 else STREET.seen_from(dx=0.2).pixels
    answer = query(client, taken, zoom=zoom, changes=True)

    drawn = client.get(answer["matches"][0]["links"]["explanation"])
    assert drawn.content.startswith(b"\x89PNG")
    assert answer["matches"][0]["view"]["place"] == "mill lane"
    # Around a narrower image nothing is missing, and nothing is new there.
    assert (answer["changes"]["status"], answer["changes"]["changes"]) == ("compared", [])


def test_a_camera_that_leans_says_by_how_much(client: CheckedClient) -> None:
    for name in ("mill lane", "market street", "rose garden"):
        enroll(client, name, photo(scene(name)))
    upright = Image.of(STREET.seen_from(dx=0.3).at("overcast").pixels)
    leaning = framed(upright, 0.7, -30).pixels  # no edge of the image is in it
    scores = [
        query(client, leaning, **told)["matches"][0] for told in ({"zoom": 1 / 0.7}, {"zoom": 1 / 0.7, "roll": 30})
    ]

    assert scores[1]["view"]["place"] == "mill lane"
    assert scores[1]["score"] > 1.2 * scores[0]["score"]


@pytest.mark.parametrize("wrong", ["-181", "180.5", "nan", "level"])
def test_a_roll_that_is_none_is_refused(client: CheckedClient, wrong: str) -> None:
    refused = client.post("/query", content=photo(STREET), params={"roll": wrong}, headers=JPEG)
    assert refused.status_code == 422
    assert [error["parameter"] for error in refused.json()["errors"]] == ["roll"]


@pytest.mark.parametrize("wrong", ["0", "0.2", "4.1", "-1", "nan", "inf", "wide"])
def test_a_zoom_that_is_none_is_refused(client: CheckedClient, wrong: str) -> None:
    refused = client.post("/query", content=photo(STREET), params={"zoom": wrong}, headers=JPEG)
    assert refused.status_code == 422
    assert [error["parameter"] for error in refused.json()["errors"]] == ["zoom"]
