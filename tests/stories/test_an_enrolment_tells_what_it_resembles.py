"""Whoever enrols is told at once that a photo adds nothing, or that the map takes it for another place."""

import io
import re
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image as PilImage

from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import RunningService

JPEG = {"content-type": "image/jpeg"}
PLACES = ("mill lane", "station road", "rose garden", "market street", "old harbour", "north gate")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[httpx.Client]:
    data = tmp_path_factory.mktemp("resembling")
    with (
        RunningService(data, REVISIT_ENCODER="compact") as service,
        httpx.Client(base_url=service.url, timeout=60) as one,
    ):
        for name in PLACES:
            for turn in (0, 5):
                assert enroll(one, photo(scene(name).seen_from(turn=turn)), place=name)["warnings"] == [], (name, turn)
        yield one


def enroll(client: httpx.Client, image: bytes, map: str = "town", **fields: Any) -> dict[str, Any]:
    answer = client.post("/enroll", params={"map": map, **fields}, content=image, headers=JPEG)
    assert answer.status_code in (200, 201, 202), answer.text
    found: dict[str, Any] = answer.json()
    return found


def again(image: bytes, quality: int = 55) -> bytes:
    """The same photo as a messenger would send it on."""
    with PilImage.open(io.BytesIO(image)) as opened:
        buffer = io.BytesIO()
        opened.resize((opened.width * 9 // 10, opened.height * 9 // 10)).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def test_the_same_photo_saved_again_is_a_duplicate(client: httpx.Client) -> None:
    first = client.get("/views?map=town&place=mill lane").json()["views"]
    told = enroll(client, again(photo(scene("mill lane").seen_from(turn=0))), place="mill lane")
    [warning] = told["warnings"]
    assert (warning["code"], warning["view"] in {view["id"] for view in first}) == ("duplicate", True)
    assert "'mill lane'" in warning["detail"]
    assert (told["created"], told["view"]["state"]) == (True, "ready")  # enrolled all the same


def test_a_photo_under_another_places_name_is_a_look_alike_too(client: httpx.Client) -> None:
    told = enroll(client, again(photo(scene("rose garden").seen_from(turn=5)), 60), place="town hall")
    assert [warning["code"] for warning in told["warnings"]] == ["duplicate", "look-alike"]
    assert "'rose garden'" in told["warnings"][1]["detail"]


def test_a_view_of_another_place_from_nearby_is_a_look_alike(client: httpx.Client) -> None:
    told = enroll(client, photo(scene("old harbour").seen_from(dx=0.2, turn=2)), place="new harbour")
    [warning] = told["warnings"]
    rival = client.get(f"/views/{warning['view']}").json()
    assert (warning["code"], rival["place"]) == ("look-alike", "old harbour")


def test_the_users_word_on_places_and_positions_counts(client: httpx.Client) -> None:
    """Neither a further view of the place, nor one without a name, nor one close by is a look-alike."""
    for turn, fields in ((-3, {"place": "north gate"}), (3, {})):
        look = photo(scene("north gate").seen_from(dx=0.2, turn=turn))
        assert "look-alike" not in [warning["code"] for warning in enroll(client, look, **fields)["warnings"]]
    enroll(client, photo(scene("quay").seen_from()), map="metres", x=0.0, y=0.0)
    near = enroll(client, photo(scene("quay").seen_from(dx=0.2, turn=2)), map="metres", x=3.0, y=0.0)
    far = enroll(client, photo(scene("quay").seen_from(dx=0.2, turn=-2)), map="metres", x=300.0, y=0.0)
    assert near["warnings"] == []
    assert [warning["code"] for warning in far["warnings"]] == ["look-alike"]


def test_an_image_that_is_there_already_or_not_waited_for_tells_nothing(client: httpx.Client) -> None:
    image = photo(scene("mill lane").seen_from(turn=0))
    assert enroll(client, image, place="mill lane")["warnings"] == []
    assert enroll(client, again(image, 50), place="mill lane", wait="false")["warnings"] == []


def test_what_it_costs_is_told(client: httpx.Client) -> None:
    told = enroll(client, photo(scene("ferry").seen_from()), place="ferry")
    assert 0 < told["timing_ms"]["compare"] < told["timing_ms"]["total"]
    assert re.fullmatch(r"[0-9a-f-]{36}", told["view"]["id"])
    assert np.isfinite(told["timing_ms"]["compare"])


def test_the_second_place_of_a_map_is_not_taken_for_its_only_one(client: httpx.Client) -> None:
    """However many views that has: nothing else tells what wrong answers get."""
    for turn in range(12):
        enroll(client, photo(scene("corridor 1").seen_from(dx=0.1 * turn, turn=turn)), map="hall", place="ground")
    second = photo(scene("corridor 2"))
    answer = client.post("/query", params={"map": "hall"}, content=second, headers=JPEG).json()
    assert answer["status"] == "no_match"
    assert enroll(client, second, map="hall", place="above")["warnings"] == []
