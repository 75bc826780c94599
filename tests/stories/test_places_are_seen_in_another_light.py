"""A map of the day is queried at night: what matches by little is proposed, and taken only where two photos agree."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from scenes import scene
from tests.openapi import CheckedClient
from tests.stories.full_queues import full_at_the_second_image
from tests.stories.photos import photo
from tests.stories.running import settings
from tests.waiting import until
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
PLACES = ("mill lane", "station road", "rose garden", "old harbour")


class Town:
    """A service with the map ``town``: four places by day, each with a position."""

    def __init__(self, client: CheckedClient) -> None:
        self.client = client
        for number, name in enumerate(PLACES):
            for turn in (0, 6):
                given = {"map": "town", "place": name, "x": 10.0 * number, "y": 1.0}
                image = photo(scene(name).seen_from(turn=turn))
                assert client.post("/enroll", params=given, content=image, headers=JPEG).status_code == 201

    def set(self, **changes: int) -> Any:
        answer = self.client.patch("/maps/town", json=changes)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def at_night(self, name: str, dx: float, **given: Any) -> Any:
        image = photo(scene(name).at("night").seen_from(dx=dx, turn=3))
        answer = self.client.post("/query", params={"map": "town", **given}, content=image, headers=JPEG).json()
        assert (answer["status"], answer["places"][0]["place"]) == ("matched", name)
        return answer

    def proposals(self, **given: Any) -> Any:
        answer = self.client.get("/maps/town/proposals", params=given)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def accept(self, proposal: Any, **wanted: Any) -> Any:
        return self.client.post(f"/maps/town/proposals/{proposal['id']}", json=wanted)

    def settle(self) -> None:
        """Wait until all views are described."""
        until(lambda: not self.client.get("/maps/town").json()["views"]["pending"])


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[Town]:
    data: Path = tmp_path_factory.mktemp("town")
    runtime = build(settings(data, encoder="compact", compare=False, decoders=0))
    with CheckedClient(create_app(runtime)) as client:
        yield Town(client)


@pytest.fixture(autouse=True)
def nothing_kept(town: Town) -> None:
    town.set(keep_matches=0)


def test_nothing_is_kept_unless_the_map_says_so_nor_what_looks_alike(town: Town) -> None:
    town.at_night("station road", 0.8)
    assert (town.proposals()["kept"], town.proposals()["keep_matches"]) == (0, 0)
    assert town.set(keep_matches=10)["keep_matches"] == 10
    same = photo(scene("mill lane").seen_from(turn=1))
    assert town.client.post("/query?map=town", content=same, headers=JPEG).json()["status"] == "matched"
    town.at_night("station road", 0.8, place="station road")  # a part of the map was searched
    assert town.proposals()["kept"] == 0
    for wrong in (-1, 10_001, "many", True):
        assert town.client.patch("/maps/town", json={"keep_matches": wrong}).status_code == 422
    assert town.client.get("/maps/moon/proposals").status_code == 404


def test_what_two_photos_agree_on_becomes_views_of_the_place_and_makes_the_next_query_surer(town: Town) -> None:
    town.set(keep_matches=10)
    before = town.at_night("station road", 0.9)
    town.at_night("station road", 0.5)
    town.at_night("rose garden", 0.8)

    found = town.proposals()
    assert (found["kept"], found["examined"], found["count"], found["keep_matches"]) == (3, 3, 2, 10)
    assert len(town.proposals(limit=1)["proposals"]) == 1
    road, garden = found["proposals"]
    assert (road["place"], road["count"], road["confirmed"]) == ("station road", 2, 2)
    assert (garden["place"], garden["count"], garden["confirmed"]) == ("rose garden", 1, 0)
    assert road["queries"][0] == road["id"]
    assert 0 < road["lowest_score"] <= road["highest_score"] < 0.7
    assert town.client.get(road["links"]["view"]).json()["place"] == "station road"
    image = town.client.get(road["links"]["image"])
    assert (image.status_code, image.headers["content-type"]) == (200, "image/jpeg")

    refused = town.accept(garden)
    assert (refused.status_code, refused.json()["type"]) == (409, "urn:revisit:problem:conflict")
    assert "no two images" in refused.json()["detail"]

    taken = town.accept(road, views=1).json()
    [view] = taken["views"]
    assert taken["queries"] == 2
    assert (view["place"], view["position"]["x"]) == ("station road", 10.0)
    assert view["metadata"] == {"proposed_by": road["id"]}
    town.settle()
    after = town.at_night("station road", 0.8)
    assert after["matches"][0]["view"]["id"] == view["id"]
    assert after["matches"][0]["score"] > before["matches"][0]["score"] + 0.1
    assert [one["place"] for one in town.proposals()["proposals"]] == ["rose garden"]

    gone = town.client.request("DELETE", "/views", params={"map": "town", "metadata.proposed_by": road["id"]})
    assert gone.json()["views"] == 1  # undone


def test_one_photo_alone_is_taken_where_somebody_says_so_or_dismissed(town: Town) -> None:
    town.set(keep_matches=10)
    town.at_night("rose garden", 0.8)
    [garden] = town.proposals()["proposals"]
    [view] = town.accept(garden, unconfirmed=True).json()["views"]
    town.settle()
    assert town.client.delete(f"/views/{view['id']}").status_code == 200

    town.at_night("rose garden", 0.8)
    town.at_night("rose garden", 0.8)  # the robot stands still, and confirms nothing
    [garden] = town.proposals()["proposals"]
    assert (garden["count"], garden["confirmed"]) == (2, 0)
    assert town.client.delete(f"/maps/town/proposals/{garden['id']}").json() == {"queries": 2}
    assert town.proposals()["proposals"] == []
    assert town.accept(garden).status_code == 404
    assert town.client.delete(f"/maps/town/proposals/{garden['id']}").status_code == 404
    for wrong in ({"views": 0}, {"views": 11}, {"unconfirmed": "yes"}, {"place": "dock"}):
        assert town.accept(garden, **wrong).status_code == 422


def test_a_photo_that_was_queried_twice_is_taken_once(town: Town) -> None:
    town.set(keep_matches=10)
    for _ in range(2):
        town.at_night("rose garden", 0.7)
    [garden] = town.proposals()["proposals"]

    taken = town.accept(garden, unconfirmed=True)

    assert taken.status_code == 200, taken.text
    assert (len(taken.json()["views"]), taken.json()["queries"]) == (1, 2)
    assert town.proposals()["kept"] == 0
    town.settle()
    assert town.client.delete(f"/views/{taken.json()['views'][0]['id']}").status_code == 200


def test_a_proposal_goes_with_the_view_that_it_matched(town: Town) -> None:
    town.set(keep_matches=10)
    answer = town.at_night("old harbour", 0.8)
    [harbour] = town.proposals()["proposals"]
    assert harbour["view"] == answer["matches"][0]["view"]["id"]
    town.client.delete(f"/views/{harbour['view']}")
    assert town.proposals()["kept"] == 0
    assert town.client.get(harbour["links"]["image"]).status_code == 404


def test_a_place_takes_ten_views_from_proposals_and_no_more(town: Town, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.service.proposals.MOST_ADDED", 1)
    town.set(keep_matches=10)
    town.at_night("station road", 0.9)
    [road] = town.proposals()["proposals"]
    [view] = town.accept(road, unconfirmed=True).json()["views"]
    town.settle()

    town.at_night("station road", -1.5)  # from the other side, it looks unlike the night view too
    [road] = town.proposals()["proposals"]
    refused = town.accept(road, unconfirmed=True)
    assert (refused.status_code, "as many as are taken" in refused.json()["detail"]) == (409, True)
    assert town.client.delete(f"/views/{view['id']}").status_code == 200


def test_a_proposal_that_was_refused_half_way_is_taken_when_it_is_sent_again(
    town: Town, monkeypatch: pytest.MonkeyPatch
) -> None:
    town.set(keep_matches=10)
    for dx in (0.85, 0.45):
        town.at_night("station road", dx)
    [road] = town.proposals()["proposals"]
    full_at_the_second_image(monkeypatch)
    assert town.accept(road, unconfirmed=True).status_code == 429
    taken = town.accept(road, unconfirmed=True).json()
    assert [view["metadata"]["proposed_by"] for view in taken["views"]] == road["queries"]
    assert (taken["queries"], town.proposals()["proposals"]) == (2, [])
    town.settle()
    for view in taken["views"]:
        assert town.client.delete(f"/views/{view['id']}").status_code == 200
