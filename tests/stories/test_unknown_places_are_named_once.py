"""The inbox: photos of places that a map lacks come back as a short list, and the owner names each once."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from app.http.application import create_app
from schemas.errors import NothingStatic
from schemas.inbox import QueryToKeep
from tests.openapi import CheckedClient
from tests.sample_images import encoded
from tests.stories.full_queues import full_at_the_second_image
from tests.stories.running import settings
from tests.waiting import until
from worker.runtime import Runtime, build
from worker.storage.kept_queries import KeptQueries
from worker.storage.tables import KEPT_QUERIES

JPEG = {"content-type": "image/jpeg"}
KNOWN = ("mill lane", "station road", "rose garden", "market street", "castle park")


def photo(name: str, quality: int = 92) -> bytes:
    """A wall of coloured tiles, other ones for another name."""
    tiles = np.random.default_rng(list(name.encode())).integers(0, 256, (12, 16, 3), np.uint8)
    return encoded(tiles.repeat(20, axis=0).repeat(20, axis=1), "jpeg", quality=quality)


class Town:
    """A service with the map ``town`` of five places, which keeps queries."""

    def __init__(self, client: CheckedClient, runtime: Runtime) -> None:
        self.client, self.runtime = client, runtime
        for name in KNOWN:
            params = {"map": "town", "place": name}
            assert client.post("/enroll", params=params, content=photo(name), headers=JPEG).status_code == 201

    def keep(self, count: int) -> Any:
        answer = self.client.patch("/maps/town", json={"keep_queries": count})
        assert answer.status_code == 200, answer.text
        return answer.json()

    def query(self, name: str, quality: int = 92, **params: Any) -> str:
        """The status of the answer to a photo of a place."""
        answer = self.client.post(
            "/query", params={"map": "town", **params}, content=photo(name, quality), headers=JPEG
        )
        assert answer.status_code == 200, answer.text
        return str(answer.json()["status"])

    def unknown(self, **params: Any) -> Any:
        answer = self.client.get("/maps/town/unknown", params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()


@pytest.fixture
def town(tmp_path: Path) -> Iterator[Town]:
    runtime = build(settings(tmp_path, compare=False))
    with CheckedClient(create_app(runtime)) as client:
        yield Town(client, runtime)


def test_nothing_is_kept_unless_the_map_says_so(town: Town) -> None:
    assert town.query("dock") == "no_match"
    assert (town.unknown()["keep_queries"], town.unknown()["kept"]) == (0, 0)
    assert town.client.get("/maps/town").json()["keep_queries"] == 0
    for wrong in (-1, 10_001, "many", None, True):
        assert town.client.patch("/maps/town", json={"keep_queries": wrong}).status_code == 422
    assert town.client.get("/maps/moon/unknown").status_code == 404


def test_a_place_seen_thrice_is_named_once_and_known_from_then_on(town: Town) -> None:
    assert town.keep(100)["keep_queries"] == 100
    # What its owner names becomes views, also of a map that takes no near-duplicates by itself.
    assert town.client.patch("/maps/town", json={"refuse_poor": True}).status_code == 200
    for quality in (92, 80, 70):
        assert town.query("dock", quality) == "no_match"
    assert town.query("mill lane") == "matched"
    assert town.query("tower") == "no_match"
    assert town.query("chapel", place="mill lane") == "no_match"  # said of a part of the map

    inbox = town.unknown()
    assert (inbox["kept"], inbox["examined"], inbox["count"]) == (4, 4, 2)
    dock, tower = inbox["places"]
    assert (dock["count"], tower["count"]) == (3, 1)
    assert len(town.unknown(limit=1)["places"]) == 1
    image = town.client.get(dock["links"]["image"])
    assert (image.status_code, image.headers["content-type"]) == (200, "image/jpeg")

    at = {"x": 4.0, "y": 5.0, "heading": 360}  # what is left of next to nothing below 0 by `% 360`
    named = town.client.post(f"/maps/town/unknown/{dock['id']}", json={"place": "dock", "position": at}).json()
    assert named["queries"] == 3
    given = [(view["place"], view["position"]["x"], view["position"]["heading"]) for view in named["views"]]
    assert given == [("dock", 4.0, 0.0)] * 3
    for view in named["views"]:
        assert town.client.get(view["links"]["image"]).status_code == 200
    wait_until_described(town, 8)
    assert town.query("dock", 85) == "matched"

    [left] = town.unknown()["places"]
    assert left["id"] == tower["id"]
    assert town.client.delete(f"/maps/town/unknown/{tower['id']}").json() == {"queries": 1}
    assert town.unknown()["places"] == []
    for method, path in (("POST", tower["id"]), ("DELETE", dock["id"]), ("GET", f"{dock['id']}/image")):
        body = {"json": {"place": "a"}} if method == "POST" else {}
        answer = town.client.request(method, f"/maps/town/unknown/{path}", **body)
        assert answer.status_code == 404, (method, path)


def test_a_map_that_is_deleted_while_its_place_is_named_stays_deleted(
    town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    town.keep(10)
    for quality in (92, 80):
        assert town.query("dock", quality) == "no_match"
    [dock] = town.unknown()["places"]
    read = KeptQueries.image

    def read_and_delete(self: KeptQueries, name: str, query_id: str) -> bytes:
        image = read(self, name, query_id)
        assert town.client.delete("/maps/town").status_code == 200
        return image

    monkeypatch.setattr(KeptQueries, "image", read_and_delete)
    answer = town.client.post(f"/maps/town/unknown/{dock['id']}", json={"place": "dock"})
    assert (answer.status_code, answer.json()["type"]) == (404, "urn:revisit:problem:not-found")
    assert town.client.get("/maps").json() == {"maps": []}


def test_a_map_keeps_a_query_of_several_that_another_one_cannot_keep(
    town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    town.keep(10)
    params = {"map": "park", "place": "pond"}
    assert town.client.post("/enroll", params=params, content=photo("pond"), headers=JPEG).status_code == 201
    assert town.client.patch("/maps/park", json={"keep_queries": 10}).status_code == 200
    keep = KeptQueries.keep

    def refused_in_town(self: KeptQueries, name: str, query: QueryToKeep) -> None:
        if name == "town":
            raise NothingStatic("all of it would be blurred")
        keep(self, name, query)

    monkeypatch.setattr(KeptQueries, "keep", refused_in_town)
    answer = town.client.post("/query", params={"maps": "town,park"}, content=photo("dock"), headers=JPEG)
    assert answer.json()["status"] == "no_match"
    assert town.unknown()["kept"] == 0
    assert town.client.get("/maps/park/unknown").json()["kept"] == 1


def test_a_name_that_was_refused_half_way_is_taken_when_it_is_sent_again(
    town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    town.keep(10)
    for quality in (92, 80, 70):
        assert town.query("dock", quality) == "no_match"
    [dock] = town.unknown()["places"]
    full_at_the_second_image(monkeypatch)
    name = partial(town.client.post, f"/maps/town/unknown/{dock['id']}", json={"place": "dock"})
    assert name().status_code == 429
    assert [one["id"] for one in town.unknown()["places"]] == [dock["id"]]

    named = name().json()
    assert (len({view["id"] for view in named["views"]}), named["queries"]) == (3, 3)
    wait_until_described(town, len(KNOWN) + 3)
    assert town.unknown()["places"] == []


def wait_until_described(town: Town, views: int) -> None:
    until(lambda: town.client.get("/maps/town").json()["views"]["ready"] >= views)


def test_a_name_is_checked_before_anything_is_enrolled(town: Town) -> None:
    town.keep(10)
    town.query("dock")
    [dock] = town.unknown()["places"]
    for body, wrong in (
        ({}, "place"),
        ({"place": "dock", "position": {"x": 1}}, "position.y"),
        ({"place": "dock", "position": {"x": 1, "y": 1, "lat": 1, "lon": 1}}, "position.x"),
        ({"place": "dock", "colour": "red"}, "colour"),
    ):
        answer = town.client.post(f"/maps/town/unknown/{dock['id']}", json=body)
        assert answer.status_code == 422, answer.text
        assert wrong in [error["parameter"] for error in answer.json()["errors"]]
    assert town.unknown()["kept"] == 1
    assert town.client.get("/maps/town").json()["views"] == {"pending": 0, "ready": 5, "failed": 0}


def test_the_oldest_are_dropped_and_nothing_is_left_of_a_deleted_map(town: Town) -> None:
    town.keep(2)
    for name in ("dock", "tower", "chapel"):
        assert town.query(name) == "no_match"
    kept = town.unknown()
    assert (kept["kept"], kept["count"]) == (2, 2)

    town.keep(1)
    assert town.unknown()["kept"] == 1
    assert town.unknown()["places"][0]["id"] == kept["places"][1]["id"]
    assert town.client.get("/maps/town/unknown", params={"limit": 0}).status_code == 422

    town.query("dock")
    town.keep(3)
    town.query("tower")
    assert town.client.delete("/maps/town").json() == {
        "views": 5,
        "descriptions": 5,
        "searched": 5,
        "images": 5,
        "images_shared": 0,
        "queries": 2,
        "scores": 0,
        "revision": None,
        "snapshots": [],
        "snapshots_of_others": 0,
    }
    with town.runtime.store._database.reading() as connection:
        assert connection.scalar(sa.select(sa.func.count()).select_from(KEPT_QUERIES)) == 0
