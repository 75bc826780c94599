"""The floors of a house are maps of their own; who does not know the floor asks them all, and gets one verdict."""

from typing import Any

import httpx
import pytest

from scenes import building
from tests.stories.photos import jpeg
from tests.stories.running import RunningService
from tests.waiting import advanced

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

JPEG = {"content-type": "image/jpeg"}
HOUSE = building(seed=3, floors=2, spots=3, kind="lobby")
BOTH = "floor1,floor2"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Any:
    data = tmp_path_factory.mktemp("house")
    with (
        RunningService(data, REVISIT_ENCODER="compact", REVISIT_COMPARE="true") as one,
        httpx.Client(base_url=one.url, timeout=60) as client,
    ):
        for floor, spot, image in HOUSE.enrolments():
            known = {"map": f"floor{floor}", "place": f"spot {spot}", "x": str(spot * 20), "y": "0"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
        settled(client, *BOTH.split(","))
        yield client


def settled(client: httpx.Client, *maps: str) -> None:
    """Wait until all views of some maps are compared with one another."""
    for name in maps:
        advanced(
            lambda name=name: client.get(f"/maps/{name}").json(),  # type: ignore[misc]
            lambda facts: facts["decision"]["views_compared"] == facts["views"]["ready"],
        )


def query(client: httpx.Client, taken: bytes, **parameters: Any) -> dict[str, Any]:
    answer = client.post("/query", params=parameters, content=taken, headers=JPEG)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_two_floors_are_ranked_as_one_map_of_both(client: httpx.Client) -> None:
    for floor, spot, image in HOUSE.enrolments():
        known = {"map": "house", "place": f"floor{floor}/spot {spot}"}
        assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
    right = 0
    for floor, spot, image in HOUSE.queries(2):
        both, house = query(client, jpeg(image), maps=BOTH), query(client, jpeg(image), map="house")
        assert [match["score"] for match in both["matches"]] == [match["score"] for match in house["matches"]]
        views = [match["view"] for match in both["matches"]]
        assert [f"{view['map']}/{view['place']}" for view in views] == [m["view"]["place"] for m in house["matches"]]
        assert {both["map"], both["places"][0]["map"]} == {views[0]["map"]}
        right += (views[0]["map"], views[0]["place"]) == (f"floor{floor}", f"spot {spot}")
        assert both["status"] != "matched" or views[0]["map"] == f"floor{floor}"
    assert right >= 7  # of 12: the floors differ in a sign or a plant


def test_the_answer_tells_of_each_map(client: httpx.Client) -> None:
    taken = jpeg(next(iter(HOUSE.queries(1)))[2])
    answer = query(client, taken, maps=BOTH)
    told = [(one["map"], one["searched"], one["pending"]) for one in answer["maps"]]
    assert told == [("floor1", 3, 0), ("floor2", 3, 0)]
    assert answer["searched"] == 6
    assert sum(one["probability"] for one in answer["maps"]) + answer["nowhere"] == pytest.approx(1, abs=1e-4)
    revisions = {name: client.get(f"/maps/{name}").json()["revision"] for name in BOTH.split(",")}
    assert {one["map"]: one["revision"] for one in answer["maps"]} == revisions
    assert answer["revision"] == revisions[answer["map"]]
    # Spots of both floors have the same names and positions, in frames of their own: they stay apart.
    assert len({(place["map"], place["place"]) for place in answer["places"]}) == len(answer["places"]) == 6
    assert query(client, taken, map="floor1")["maps"] is None


def test_a_position_is_of_one_map_alone(client: httpx.Client) -> None:
    told = 0
    for _, _, image in HOUSE.queries(1):
        answer = query(client, jpeg(image), maps=BOTH)
        if answer["estimate"] is not None:
            maps = {client.get(f"/views/{one}").json()["map"] for one in answer["estimate"]["views"]}
            assert maps == {answer["map"]}
            told += 1
    assert told >= 3


def test_maps_of_different_recipes_are_given_together(client: httpx.Client) -> None:
    other = {"preset": "paper"}
    assert client.put("/maps/attic", json=other).status_code == 201
    for name in ("attic", "cellar"):
        for _, spot, image in HOUSE.unknown(1):
            known = {"map": name, "place": f"spot {spot}"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
    settled(client, "attic", "cellar")
    answer = query(client, jpeg(next(iter(HOUSE.unknown(1)))[2]), maps="floor1,attic,floor2")
    assert [one["map"] for one in answer["maps"]] == ["floor1", "attic", "floor2"]
    assert len({one["recipe"] for one in answer["maps"]}) == 2
    assert sum(one["probability"] for one in answer["maps"]) + answer["nowhere"] == pytest.approx(1, abs=1e-4)
    confidences = [match["confidence"] for match in answer["matches"]]
    assert confidences == sorted(confidences, reverse=True)
    assert [match["rank"] for match in answer["matches"]] == list(range(1, 6))


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
    # The runner-up is of the other map, and drawn too: both maps have one recipe.
    assert client.get(both["matches"][1]["links"]["explanation"]).status_code == 200


def test_an_estimated_position_is_in_the_frame_of_the_first_places_map(client: httpx.Client) -> None:
    """Surveyed twice, from origins 8 m apart: a mean of both would be a position in neither."""
    origins = {"spring": 2.0, "autumn": 10.0}
    spots = [(spot, image) for floor, spot, image in HOUSE.enrolments() if floor == 1]
    for name, origin in origins.items():
        for spot, image in spots:
            known = {"map": name, "place": f"spot {spot}", "x": str(origin + 100 * spot), "y": "0"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
    settled(client, *origins)
    spot, image = spots[0]
    answer = query(client, jpeg(image), maps="spring,autumn")
    first, second = (match["view"] for match in answer["matches"][:2])
    assert {first["map"], second["map"]} == set(origins)
    estimate = answer["estimate"]
    assert estimate["position"]["x"] == pytest.approx(origins[answer["map"]] + 100 * spot)
    assert (estimate["views"], estimate["radius_m"]) == ([first["id"]], pytest.approx(100.0))


def test_an_estimate_is_of_matches_where_maps_are_ranked_apart_too(client: httpx.Client) -> None:
    assert client.put("/maps/yard", json={"ranking": {"precision": 0.9}}).status_code == 201
    for number, (_, spot, image) in enumerate(HOUSE.enrolments()):
        for name in ("hall", "yard"):  # all views of one lie within reach of each other
            known = {"map": name, "place": f"spot {number}", "x": str(7 * spot), "y": "0"}
            assert client.post("/enroll", params=known, content=jpeg(image), headers=JPEG).status_code == 201
    settled(client, "hall", "yard")
    for _, _, image in HOUSE.queries(1):
        answer = query(client, jpeg(image), maps="hall,yard", top=3)
        assert {match["view"]["map"] for match in answer["matches"]} == {"hall", "yard"}
        assert set(answer["estimate"]["views"]) < {match["view"]["id"] for match in answer["matches"]}


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
        ({"maps": "floor1,nowhere"}, 404),
        ({"maps": "floor1,floor1"}, 422),
        ({"maps": "floor1", "map": "floor2"}, 422),
        ({"maps": BOTH, "drive": "robot"}, 422),
        ({"maps": "floor1,,floor2"}, 422),
        ({"maps": ",".join(f"m{i}" for i in range(17))}, 422),
    ):
        answer = client.post("/query", params=wrong, content=taken, headers=JPEG)
        assert answer.status_code == status, answer.text
