"""The floors of a house are maps of their own; who does not know the floor asks them all, and gets one verdict."""

import time
from typing import Any

import httpx
import pytest

from scenes import building
from tests.stories.photos import jpeg
from tests.stories.running import RunningService

Answered = tuple[str, str, dict[str, Any], dict[str, dict[str, Any]]]
"""Floor and spot of a query, what both floors say together, and what each says by itself."""

JPEG = {"content-type": "image/jpeg"}
HOUSE = building(seed=3, floors=2, spots=3, kind="lobby")
BOTH = "floor1,floor2"
PATIENCE_S = 120


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Any:
    data = tmp_path_factory.mktemp("house")
    with RunningService(data, REVISIT_ENCODER="compact") as one, httpx.Client(base_url=one.url, timeout=60) as client:
        for floor, spot, image in HOUSE.enrolments():
            known = {"map": f"floor{floor}", "place": f"spot {spot}", "x": str(spot * 20), "y": "0"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
        settled(client, *BOTH.split(","))
        yield client


def settled(client: httpx.Client, *maps: str) -> None:
    """Wait until all views of some maps are compared with one another."""
    until = time.monotonic() + PATIENCE_S
    for name in maps:
        while (facts := client.get(f"/maps/{name}").json())["decision"]["views_compared"] < facts["views"]["ready"]:
            assert time.monotonic() < until, facts["decision"]
            time.sleep(0.1)


def query(client: httpx.Client, taken: bytes, **parameters: Any) -> dict[str, Any]:
    answer = client.post("/query", params=parameters, content=taken, headers=JPEG)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture(scope="module")
def answers(client: httpx.Client) -> list[Answered]:
    """Each query of the house."""
    found = []
    for floor, spot, image in HOUSE.queries(2):
        taken = jpeg(image)
        alone = {name: query(client, taken, map=name) for name in BOTH.split(",")}
        found.append((f"floor{floor}", f"spot {spot}", query(client, taken, maps=BOTH), alone))
    return found


def test_the_floor_is_found(answers: list[Answered]) -> None:
    right = [
        (one["map"], one["matches"][0]["view"]["map"], one["places"][0]["place"]) == (floor, floor, spot)
        for floor, spot, one, _ in answers
    ]
    assert sum(right) >= 0.8 * len(right)
    sure = [found for found, (_, _, one, _) in zip(right, answers, strict=True) if one["status"] == "matched"]
    assert all(sure)


def test_both_floors_together_are_never_surer_than_one(
    answers: list[Answered],
) -> None:
    for _, _, one, alone in answers:
        assert one["confidence"] <= alone[one["map"]]["confidence"] + 1e-6
        assert one["nowhere"] + sum(place["probability"] for place in one["places"]) == pytest.approx(1, abs=1e-4)
        assert one["searched"] == 6
        told = [(said["map"], said["status"], said["confidence"], said["reason"]["code"]) for said in one["maps"]]
        assert told == [(name, a["status"], a["confidence"], a["reason"]["code"]) for name, a in alone.items()]
        confidences = [match["confidence"] for match in one["matches"]]
        assert confidences == sorted(confidences, reverse=True)
        assert [match["rank"] for match in one["matches"]] == list(range(1, 6))


def test_a_floor_enrolled_twice_is_its_own_look_alike(client: httpx.Client) -> None:
    """Two maps of one place: each is sure, and together they cannot be."""
    for number, (_, spot, image) in enumerate(HOUSE.enrolments()):
        for name in ("today", "yesterday"):
            known = {"map": name, "place": f"spot {number % 3}/{spot}"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
    settled(client, "today", "yesterday")
    taken = jpeg(next(iter(HOUSE.enrolments()))[2])
    alone = [query(client, taken, map=name) for name in ("today", "yesterday")]
    assert [one["status"] for one in alone] == ["matched", "matched"]
    both = query(client, taken, maps="today,yesterday", explain=True)
    assert (both["status"], both["reason"]["code"]) == ("ambiguous", "look-alike")
    assert {both["map"], both["reason"]["rival"]["view"]["map"]} == {"today", "yesterday"}
    assert both["confidence"] < 0.6
    assert client.get(both["matches"][0]["links"]["explanation"]).status_code == 200
    others = [match for match in both["matches"] if match["view"]["map"] != both["map"]]
    assert [match["links"]["explanation"] for match in others] == [None] * len(others)


def test_views_of_any_of_the_maps_can_be_left_out(client: httpx.Client) -> None:
    taken = jpeg(next(iter(HOUSE.enrolments()))[2])
    first = query(client, taken, maps=BOTH)["matches"][0]["view"]
    again = query(client, taken, maps=BOTH, exclude=first["id"])
    assert again["searched"] == 5
    assert first["id"] not in [match["view"]["id"] for match in again["matches"]]
    unknown = {"maps": BOTH, "exclude": f"{first['id']},none"}
    refused = client.post("/query", params=unknown, content=taken, headers=JPEG)
    assert (refused.status_code, refused.json()["errors"][0]["parameter"]) == (422, "exclude")
    assert "none" in refused.json()["detail"]


def test_what_is_wrong_is_said(client: httpx.Client) -> None:
    taken = jpeg(next(iter(HOUSE.enrolments()))[2])
    for wrong, status in (
        ({"maps": "floor1,attic"}, 404),
        ({"maps": "floor1,floor1"}, 422),
        ({"maps": "floor1", "map": "floor2"}, 422),
        ({"maps": BOTH, "drive": "robot"}, 422),
        ({"maps": "floor1,,floor2"}, 422),
        ({"maps": ",".join(f"m{i}" for i in range(17))}, 422),
    ):
        answer = client.post("/query", params=wrong, content=taken, headers=JPEG)
        assert answer.status_code == status, answer.text
