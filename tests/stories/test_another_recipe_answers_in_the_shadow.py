"""A recipe is tried beside that of a map: both answer its queries, and the map changes over when it is told."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import encoded
from tests.stories.running import settings
from worker.runtime import Runtime, build

JPEG = {"content-type": "image/jpeg"}
OTHER = {"labels": ["road", "sky", "building"], "dynamic": []}


@pytest.fixture
def runtime(database: str, tmp_path: Path) -> Runtime:
    """Searched in memory, and in PostgreSQL."""
    return build(settings(tmp_path, compare=False, index="pgvector" if database == "postgresql" else "faiss"))


@pytest.fixture
def client(runtime: Runtime) -> Iterator[CheckedClient]:
    with CheckedClient(create_app(runtime)) as client:
        for seed in range(4):
            enroll(client, seed)
        yield client


def image(seed: int) -> bytes:
    """A wall of coloured tiles, other ones for another seed."""
    tiles = np.random.default_rng(seed).integers(0, 256, (12, 16, 3), np.uint8)
    return encoded(tiles.repeat(20, axis=0).repeat(20, axis=1), "jpeg")


def enroll(client: CheckedClient, seed: int) -> Any:
    answer = client.post(f"/enroll?place=place-{seed // 2}", content=image(seed), headers=JPEG)
    assert answer.status_code == 201
    return answer.json()["view"]


def ask(client: CheckedClient, seed: int) -> dict[str, Any]:
    """An answer, without what differs from call to call."""
    answer: dict[str, Any] = client.post("/query?top=10", content=image(seed), headers=JPEG).json()
    del answer["timing_ms"], answer["query"]["id"]
    return answer


def until(get: Callable[[], Any], right: Callable[[Any], bool]) -> Any:
    for _ in range(600):
        found = get()
        if right(found):
            return found
        time.sleep(0.02)
    raise AssertionError(f"still {found}")


def begun(client: CheckedClient, queries: int = 6) -> Any:
    answer = client.post("/maps/default/recipe", json={**OTHER, "shadow": queries})
    assert answer.status_code == 202
    assert answer.json()["kind"] == "shadow"
    return answer.json()


def ready(client: CheckedClient) -> Any:
    return until(lambda: client.get("/maps/default/shadow").json(), lambda found: found["state"] == "ready")


def test_both_recipes_answer_the_kept_queries_and_the_map_changes_over_when_it_is_told(client: CheckedClient) -> None:
    client.patch("/maps/default", json={"keep_queries": 10})
    for seed in (50, 51):
        assert ask(client, seed)["status"] == "no_match"
    before = [ask(client, seed) for seed in (0, 3)]
    old_recipe = client.get("/maps/default").json()["recipe"]["id"]

    job = begun(client)
    shadow = ready(client)

    table, totals = shadow["table"], shadow["table"]["totals"]
    assert (totals["queries"], totals["kept"], totals["views"]) == (6, 2, 4)
    assert [row["source"] for row in sorted(table["queries"], key=lambda row: row["source"])] == ["kept"] * 2 + [
        "view"
    ] * 4
    assert (table["old_recipe"], table["recipe"]) == (old_recipe, shadow["recipe"]["id"])
    assert shadow["recipe"]["labels"] == OTHER["labels"]
    assert (table["old_views"], table["new_views"]) == (4, 4)
    assert totals["known"] == 4
    assert totals["agree"] == sum(row["agree"] for row in table["queries"])
    assert totals["old"]["describe_ms"] > 0
    assert totals["new"]["search_ms"] > 0
    kept = next(row for row in table["queries"] if row["source"] == "kept")
    assert client.get(f"/maps/default/unknown/{kept['id']}/image").content.startswith(b"\xff\xd8")
    assert client.get(f"/jobs/{job['id']}").json()["result"]["totals"] == totals
    assert [ask(client, seed) for seed in (0, 3)] == before

    switched = client.post("/maps/default/shadow/switch")

    assert switched.status_code == 202
    assert (switched.json()["kind"], switched.json()["state"]) == ("recipe", "done")
    assert client.get("/maps/default").json()["recipe"]["id"] == shadow["recipe"]["id"]
    assert client.get("/maps/default/shadow").status_code == 404
    assert client.post("/maps/default/shadow/switch").status_code == 404
    assert ask(client, 0)["recipe"] == shadow["recipe"]["id"]
    decided = client.get(f"/jobs/{job['id']}").json()["result"]
    assert (decided["totals"], decided["queries"]) == (totals, [])


def test_a_view_on_another_floor_does_not_show_the_place(client: CheckedClient) -> None:
    """Three floors surveyed at one spot, the lowest from two sides: only there can a first place be right."""
    assert client.put("/maps/tower", json={}).status_code == 201
    for seed, (x, z) in enumerate([(0.0, 0.0), (0.5, 0.0), (0.0, 12.0), (0.0, 24.0)]):
        known = {"map": "tower", "x": x, "y": 0.0, "z": z}
        assert client.post("/enroll", params=known, content=image(seed), headers=JPEG).status_code == 201
    assert client.post("/maps/tower/recipe", json={**OTHER, "shadow": 4}).status_code == 202

    shadow = until(lambda: client.get("/maps/tower/shadow").json(), lambda found: found["state"] == "ready")

    assert (shadow["table"]["totals"]["queries"], shadow["table"]["totals"]["known"]) == (4, 2)


def test_a_discarded_shadow_leaves_the_map_as_it_was(client: CheckedClient, runtime: Runtime) -> None:
    before, facts = ask(client, 1), client.get("/maps/default").json()
    begun(client)
    shadow = ready(client)

    assert client.delete("/maps/default/shadow").json()["state"] == "done"

    assert client.get("/maps/default/shadow").status_code == 404
    assert ask(client, 1) == before
    assert client.get("/maps/default").json() == facts
    while runtime.store.pruning.prune():
        pass
    assert len(runtime.store.descriptions.described("default", shadow["recipe"]["id"])) == 0
    assert client.post("/maps/default/recipe", json={**OTHER, "shadow": 1}).status_code == 202


def test_views_that_come_and_go_meanwhile_are_right_by_both_recipes(client: CheckedClient) -> None:
    begun(client)
    rows = ready(client)["table"]["queries"]
    new = enroll(client, 8)
    gone = rows[0]["id"]
    assert client.delete(f"/views/{gone}").status_code == 200
    assert ask(client, 8)["matches"][0]["view"]["id"] == new["id"]
    left = client.get("/maps/default/shadow").json()["table"]["queries"]
    assert not any(gone in (row["id"], row["old"]["view"], row["new"]["view"]) for row in left)

    job = client.post("/maps/default/shadow/switch").json()
    until(lambda: client.get(f"/jobs/{job['id']}").json(), lambda found: found["state"] == "done")

    answer = ask(client, 8)
    assert answer["matches"][0]["view"]["id"] == new["id"]
    assert answer["searched"] == 4
    assert gone not in [match["view"]["id"] for match in answer["matches"]]


def test_what_cannot_be_is_refused_with_the_reason(client: CheckedClient, runtime: Runtime) -> None:
    path = "/maps/default"
    labels = client.get(path).json()["recipe"]["labels"]
    same = client.post(f"{path}/recipe", json={"labels": labels, "shadow": 10})
    assert same.status_code == 409
    assert "by this recipe already" in same.json()["detail"]
    unusable: tuple[Any, ...] = (0, 201, -1, True, "10", 1.5, [1], {})
    for wrong in unusable:
        assert client.post(f"{path}/recipe", json={**OTHER, "shadow": wrong}).status_code == 422
    assert client.get(f"{path}/shadow").status_code == 404
    for call in (client.post(f"{path}/shadow/switch"), client.delete(f"{path}/shadow")):
        assert call.status_code == 404
        assert "POST /maps/default/recipe with `shadow`" in call.json()["detail"]
    for method, of in (("GET", "shadow"), ("POST", "shadow/switch"), ("DELETE", "shadow")):
        assert client.request(method, f"/maps/nowhere/{of}").status_code == 404
    assert client.post("/maps/nowhere/recipe", json={**OTHER, "shadow": 10}).status_code == 404
    assert client.put(path, json={"shadow": 10}).status_code == 422

    begun(client)
    ready(client)

    again = client.post(f"{path}/recipe", json={**OTHER, "shadow": 10})
    assert again.status_code == 409
    assert "POST /maps/default/shadow/switch" in again.json()["detail"]
    assert client.post(f"{path}/recipe", json=OTHER).status_code == 409
    assert client.post(f"{path}/vocabulary").status_code == 409
    assert client.patch(path, json={"keep_images": False}).status_code == 409


def test_a_shadow_of_a_map_that_is_deleted_goes_with_it(client: CheckedClient) -> None:
    job = begun(client)
    assert client.delete("/maps/default").status_code == 200
    assert client.get(f"/jobs/{job['id']}").status_code == 404
    assert client.get("/maps/default/shadow").status_code == 404
    view = enroll(client, 0)
    assert ask(client, 0)["matches"][0]["view"]["id"] == view["id"]


def test_an_empty_map_has_a_table_without_rows(client: CheckedClient) -> None:
    client.put("/maps/empty", json={})
    assert client.post("/maps/empty/recipe", json={**OTHER, "shadow": 5}).status_code == 202
    shadow = until(lambda: client.get("/maps/empty/shadow").json(), lambda found: found["state"] == "ready")
    assert (shadow["table"]["queries"], shadow["table"]["totals"]["old"]["search_ms"]) == ([], None)
    assert client.post("/maps/empty/shadow/switch").json()["state"] == "done"


def test_a_map_that_keeps_no_images_has_no_shadow(client: CheckedClient) -> None:
    client.patch("/maps/default", json={"keep_images": False})
    answer = client.post("/maps/default/recipe", json={**OTHER, "shadow": 5})
    assert (answer.status_code, "keeps no images" in answer.json()["detail"]) == (409, True)
