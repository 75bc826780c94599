"""`/maps`, `/places` and `/jobs`."""

from typing import Any

import pytest

from schemas.requests import PutMap
from tests.http.fakes import FakeRecogniser
from tests.openapi import CheckedClient
from tests.sample_images import photo


def test_a_map_is_made_once(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    wanted = {"labels": ["wall", "car"], "dynamic": ["car"], "preset": "paper", "parameters": {"candidates": 50}}
    assert client.put("/maps/campus", json=wanted).status_code == 201
    assert client.put("/maps/campus", json=wanted).status_code == 200
    assert recogniser.made["campus"] == PutMap.model_validate(wanted)
    assert client.put("/maps/plain").status_code == 201
    assert client.get("/maps/campus").json()["name"] == "campus"


def test_a_map_with_views_is_not_given_another_recipe(client: CheckedClient) -> None:
    client.post("/enroll?map=campus", content=photo(), headers={"content-type": "image/jpeg"})
    answer = client.put("/maps/campus", json={"preset": "paper"})
    assert answer.status_code == 409
    assert "POST /maps/campus/recipe" in answer.json()["detail"]
    assert [m["name"] for m in client.get("/maps").json()["maps"]] == ["campus"]


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ({"labels": []}, "labels"),
        ({"labels": "wall"}, "labels"),
        ({"labels": ["wall", ""]}, "labels.1"),
        ({"dynamic": [3]}, "dynamic.0"),
        ({"preset": 3}, "preset"),
        ({"parameters": []}, "parameters"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_map_that_cannot_be_made_is_refused_with_the_reason(
    client: CheckedClient, body: dict[str, Any], wrong: str
) -> None:
    answer = client.put("/maps/campus", json=body)
    assert answer.status_code == 422
    assert [e["parameter"] for e in answer.json()["errors"]] == [wrong]


def test_fields_of_a_ranking_change_at_once(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    client.put("/maps/campus")
    answer = client.patch(
        "/maps/campus",
        json={"ranking": {"candidates": 100}},
        headers={"content-type": "application/merge-patch+json"},
    )
    assert (answer.status_code, answer.json()["ranking"]) == (200, {"id": "changed", "candidates": 100})
    assert client.patch("/maps/nowhere", json={"ranking": {}}).status_code == 404


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ({}, "ranking"),
        ({"ranking": None}, "ranking"),
        ({"ranking": [1]}, "ranking"),
        ({"ranking": {}, "labels": ["wall"]}, "labels"),
    ],
)
def test_a_ranking_that_cannot_be_changed_is_refused_with_the_reason(
    client: CheckedClient, body: dict[str, Any], wrong: str
) -> None:
    client.put("/maps/campus")
    answer = client.patch("/maps/campus", json=body)
    assert answer.status_code == 422
    assert [e["parameter"] for e in answer.json()["errors"]] == [wrong]
    assert client.patch("/maps/campus", content=b"[").status_code == 400


@pytest.mark.parametrize("name", [".hidden", "a%20b", "%C3%A9", "a" * 65, "a%0A"])
def test_a_name_that_no_map_can_have_is_refused(client: CheckedClient, name: str) -> None:
    patched = client.patch(f"/maps/{name}", json={"ranking": {}})
    for answer in (client.get(f"/maps/{name}"), client.put(f"/maps/{name}"), patched, client.delete(f"/maps/{name}")):
        assert answer.status_code == 422
        assert answer.json()["errors"][0]["parameter"] == "map"


def test_work_on_a_map_answers_with_its_job(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    recogniser.job_states = ["waiting"]
    client.put("/maps/campus")
    for path in ("recipe", "vocabulary"):
        answer = client.post(f"/maps/campus/{path}")
        assert answer.status_code == 202
        assert client.get(answer.headers["location"]).json() == answer.json()
        assert client.post(f"/maps/nowhere/{path}").status_code == 404
    assert client.delete("/maps/campus").status_code == 200


def test_places_and_jobs(client: CheckedClient) -> None:
    assert client.get("/places?map=default&limit=5").json()["places"][0]["place"] == "hall"
    assert client.get("/places?limit=0").status_code == 422
    assert client.get("/jobs/gone").status_code == 404
    assert client.delete("/jobs/j1").status_code == 409
    assert client.get("/jobs/j1?x=1").status_code == 422


def test_jobs_are_listed_by_map_kind_and_state(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    page = client.get("/jobs?map=campus&kind=import,recipe&state=running&cursor=abc&limit=7").json()
    assert [job["id"] for job in page["jobs"]] == ["j1"]
    kinds = ("recipe", "import")
    assert recogniser.given == {"map": "campus", "kinds": kinds, "state": "running", "cursor": "abc", "limit": 7}
    client.get("/jobs")
    assert recogniser.given == {"map": None, "kinds": (), "state": None, "cursor": None, "limit": 50}


@pytest.mark.parametrize(
    "query",
    ["map=.x", "kind=odd", "kind=recipe,recipe", "kind=recipe,", "state=ready", "cursor=", "limit=501", "place=hall"],
)
def test_a_list_of_jobs_refuses_unknown_parameters(client: CheckedClient, query: str) -> None:
    answer = client.get(f"/jobs?{query}")
    assert answer.status_code == 422
    assert [e["parameter"] for e in answer.json()["errors"]] == [query.partition("=")[0]]
