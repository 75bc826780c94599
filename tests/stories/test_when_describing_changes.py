"""What was acknowledged stays when describing fails, and a map keeps what a change of recipe does not name."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from worker.description.describer import Describer
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}


@pytest.fixture
def client(tmp_path: Path) -> Iterator[CheckedClient]:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        yield client


def enroll(client: CheckedClient, seed: int, wait: str = "true") -> Any:
    return client.post(f"/enroll?wait={wait}", content=encoded(drawn(320, 240, seed), "jpeg"), headers=JPEG)


def until(client: CheckedClient, path: str, *states: str) -> Any:
    for _ in range(600):
        answer = client.get(path).json()
        if answer["state"] in states:
            return answer
        time.sleep(0.05)
    raise AssertionError(f"{path} is still {answer['state']}")


def test_a_view_that_was_acknowledged_stays_when_describing_it_fails_again(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> Any:
        raise RuntimeError("describing is broken")

    monkeypatch.setattr(Describer, "describe", fail)
    view = enroll(client, 0, wait="false").json()["view"]
    assert until(client, f"/views/{view['id']}", "failed")["failure"]["code"] == "internal"

    assert enroll(client, 0).status_code == 500
    assert client.get(f"/views/{view['id']}").status_code == 200

    assert enroll(client, 1).status_code == 500
    assert [kept["id"] for kept in client.get("/views").json()["views"]] == [view["id"]]


def test_other_labels_leave_the_parameters_the_ranking_and_the_views_of_a_map(client: CheckedClient) -> None:
    client.put("/maps/default", json={"parameters": {"local_features": 64}, "ranking": {"candidates": 7}})
    view = enroll(client, 0).json()["view"]

    begun = client.post("/maps/default/recipe", json={"labels": ["road", "sky", "building"], "dynamic": []})

    assert begun.status_code == 202
    assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
    facts = client.get("/maps/default").json()
    assert [label["label"] for label in facts["labels"]] == ["road", "sky", "building"]
    assert facts["recipe"]["parameters"]["local_features"] == 64
    assert facts["ranking"]["candidates"] == 7
    answer = client.post("/query?explain=true", content=client.get(view["links"]["image"]).content, headers=JPEG).json()
    assert answer["matches"][0]["view"]["id"] == view["id"]
    assert client.get(answer["matches"][0]["links"]["explanation"]).content.startswith(b"\x89PNG")


def test_a_map_from_before_changes_over_to_its_preset_as_it_is_now_and_keeps_what_its_user_decided(
    client: CheckedClient,
) -> None:
    before = {"parameters": {"local_features_equalised": True}, "ranking": {"shortlist_looked": 0, "precision": 0.99}}
    labels = {"labels": ["road", "sky", "building"], "dynamic": []}
    client.put("/maps/default", json={**before, **labels})
    client.put("/maps/new")
    enroll(client, 0)
    now = client.get("/maps/new").json()
    assert now["preset_differences"] == []
    assert client.get("/maps/default").json()["preset_differences"] == [
        {"parameter": "parameters.local_features_equalised", "value": True, "preset": False},
        {"parameter": "ranking.shortlist_looked", "value": 0, "preset": 1000},
    ]

    begun = client.post("/maps/default/recipe", json={"preset": "default"})

    assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
    facts = client.get("/maps/default").json()
    assert facts["preset_differences"] == []
    assert facts["recipe"]["parameters"] == now["recipe"]["parameters"]
    assert facts["ranking"] == {**now["ranking"], "precision": 0.99, "id": facts["ranking"]["id"]}
    assert [label["label"] for label in facts["labels"]] == labels["labels"]


def test_another_preset_leaves_what_the_user_decided(client: CheckedClient) -> None:
    client.put("/maps/default", json={"ranking": {"precision": 0.99, "same_place_m": 40, "candidates": 7}})
    enroll(client, 0)
    begun = client.post("/maps/default/recipe", json={"preset": "paper", "ranking": {"same_place_m": 3}})
    assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
    ranking = client.get("/maps/default").json()["ranking"]
    assert (ranking["precision"], ranking["same_place_m"], ranking["preset"]) == (0.99, 3, "paper")
    assert ranking["candidates"] != 7


@pytest.mark.parametrize("begin", ["switch_recipe", "begin_shadow"])
def test_a_ranking_that_is_changed_while_another_recipe_is_being_begun_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begin: str
) -> None:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        enroll(client, 0)
        stored = getattr(runtime.store.jobs, begin)

        def late(*given: Any) -> Any:
            assert client.patch("/maps/default", json={"ranking": {"candidates": 7}}).status_code == 200
            return stored(*given)

        monkeypatch.setattr(runtime.store.jobs, begin, late)
        wanted = {"labels": ["road", "sky", "building"], "dynamic": []} | ({"shadow": 1} if "shadow" in begin else {})

        begun = client.post("/maps/default/recipe", json=wanted)

        assert begun.status_code == 202
        assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
        path = "/maps/default" if begin == "switch_recipe" else "/maps/default/shadow"
        facts = client.get(path).json()
        assert facts["ranking"]["candidates"] == 7
        assert facts["recipe"]["labels"] == ["road", "sky", "building"]


def test_labels_are_those_that_a_view_was_described_with_when_its_map_changes_over_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        view = enroll(client, 0).json()["view"]
        stored = runtime.store.views
        read = stored.get(view["id"])
        switch = client.post("/maps/default/recipe", json={"labels": ["road", "sky", "building"], "dynamic": []})
        assert until(client, switch.headers["location"], "done", "failed")["state"] == "done"
        assert enroll(client, 1).status_code == 201

        monkeypatch.setattr(stored, "get", lambda view_id: read)  # read just before the map changed over
        monkeypatch.setattr(stored, "list", lambda *_, **__: ([read], None))
        answers = [client.get(f"/views/{view['id']}").json(), *client.get("/views").json()["views"]]

        assert [answer["description"] in (None, view["description"]) for answer in answers] == [True] * 2


def test_a_query_is_answered_by_the_recipe_it_began_with_and_the_next_by_the_new_one(tmp_path: Path) -> None:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        images = [encoded(drawn(320, 240, seed), "jpeg") for seed in range(3)]
        for seed in range(3):
            enroll(client, seed)
        first = client.get("/maps/default").json()["recipe"]["id"]
        ways: Any = {"labels": ["road", "sky", "building"], "dynamic": []}, {"labels": ["road", "sky"], "dynamic": []}
        for wanted in ways:
            begun = client.post("/maps/default/recipe", json=wanted)
            assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
        before = client.get("/maps/default").json()["recipe"]["id"]
        searcher = runtime.services.searcher
        described: list[str] = []
        changed: list[int] = []

        def change_over(stage: str, evidence: object) -> None:
            if not changed:  # back to the recipe before, by which all views are described: at once
                changed.append(client.post("/maps/default/recipe", json=ways[0]).status_code)

        describe, search = searcher.describe, searcher.search
        searcher.describe = lambda *given: described.append(given[1].recipe.id) or describe(*given)  # type: ignore
        searcher.search = partial(search, observe=change_over)  # type: ignore[method-assign]
        answer = client.post("/query", content=images[1], headers=JPEG).json()
        after = client.get("/maps/default").json()["recipe"]["id"]
        following = client.post("/query", content=images[1], headers=JPEG).json()

        assert changed == [202]
        assert len({first, before, after}) == 3
        assert described == [before, after]  # once for each query
        assert [match["view"]["description"]["recipe"] for match in answer["matches"]] == [before] * 3
        assert [match["view"]["description"]["recipe"] for match in following["matches"]] == [after] * 3
        assert answer["matches"][0]["view"]["id"] == following["matches"][0]["view"]["id"]


def test_an_explanation_is_drawn_without_cells_once_the_views_were_described_anew(tmp_path: Path) -> None:
    runtime = build(settings(tmp_path))
    with CheckedClient(create_app(runtime)) as client:
        image = client.get(enroll(client, 0).json()["view"]["links"]["image"]).content
        enroll(client, 1)
        answer = client.post("/query?explain=true", content=image, headers=JPEG).json()
        link = answer["matches"][0]["links"]["explanation"]
        before = client.get(link).content

        for labels in (["road", "sky"], ["road", "sky", "building"]):  # the recipe before the last is kept
            begun = client.post("/maps/default/recipe", json={"labels": labels, "dynamic": []})
            assert until(client, begun.headers["location"], "done", "failed")["state"] == "done"
        assert client.get(link).status_code == 200
        while runtime.store.pruning.prune():
            pass

        after = client.get(link)
        assert after.content.startswith(b"\x89PNG")
        assert after.content != before


def test_too_few_views_for_a_vocabulary_are_said_to_be_too_few(client: CheckedClient) -> None:
    enroll(client, 0)
    begun = client.post("/maps/default/vocabulary")
    assert begun.status_code == 202
    failure = until(client, begun.headers["location"], "done", "failed")["failure"]
    assert failure["code"] == "too-few-pictures"
