"""Two services on one PostgreSQL, one of which keeps no vectors: both give the same answers, at once."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest
from revisit_client import Revisit

from tests.sample_images import photo
from tests.storage.databases import postgres_schema
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("it has databases of its own")

JPEG = {"content-type": "image/jpeg"}


def answer(client: httpx.Client, number: int, **parameters: Any) -> Any:
    answered = client.post("/query", content=photo(number), headers=JPEG, params=parameters)
    assert answered.status_code == 200, answered.text
    found = answered.json()
    return found["status"], [(match["view"]["id"], match["score"]) for match in found["matches"]]


def test_what_one_service_acknowledges_the_database_finds_for_the_other(tmp_path: Path) -> None:
    with postgres_schema() as url:
        there = {"REVISIT_DATABASE": url}
        with (
            RunningService(tmp_path / "one", **there) as memory,
            RunningService(
                tmp_path / "two", False, **there, REVISIT_INDEX="pgvector", REVISIT_INLINE_WORKER="false"
            ) as database,
            httpx.Client(base_url=memory.url, timeout=40) as one,
            httpx.Client(base_url=database.url, timeout=40) as other,
        ):
            kept = []
            for number in range(4):
                sent = {"place": "north" if number % 2 else "south"}
                view = one.post("/enroll", content=photo(number), headers=JPEG, params=sent).json()["view"]["id"]
                kept.append(view)
                assert view in [seen for seen, _ in answer(other, number)[1]]
                assert answer(other, number) == answer(one, number)
            for filters in ({"place": "north"}, {"exclude_last": "2"}, {"exclude": kept[0], "top": 2}):
                assert answer(other, 0, **filters) == answer(one, 0, **filters)
            assert len(answer(other, 0, place="north", top=2)[1]) == 2

            assert one.delete(f"/views/{kept[0]}").status_code == 200
            assert kept[0] not in [seen for seen, _ in answer(other, 0)[1]]
            assert answer(other, 0) == answer(one, 0)

            ready = other.get("/readyz").json()
            assert ready["checks"]["index"] == "ok"
            assert "index" not in one.get("/readyz").json()["checks"]
            assert other.post("/query", content=photo(0), headers=JPEG, params={"exclude": "typo"}).status_code == 422


def test_a_recipe_is_tried_in_the_shadow_by_one_service_and_both_change_over(tmp_path: Path) -> None:
    """The one that keeps vectors in memory describes and compares; the other is told to change over."""
    with postgres_schema() as url:
        there = {"REVISIT_DATABASE": url}
        with (
            RunningService(tmp_path / "one", **there) as memory,
            RunningService(
                tmp_path / "two", False, **there, REVISIT_INDEX="pgvector", REVISIT_INLINE_WORKER="false"
            ) as database,
            httpx.Client(base_url=memory.url, timeout=40) as one,
            httpx.Client(base_url=database.url, timeout=40) as other,
        ):
            for number in range(4):
                one.post("/enroll", content=photo(number), headers=JPEG).raise_for_status()
            before = answer(other, 0)
            wanted = {"labels": ["road", "sky", "building"], "dynamic": [], "shadow": 10}
            job = other.post("/maps/default/recipe", json=wanted).raise_for_status().json()
            assert Revisit(database.url).wait_for_job(job["id"], timeout=60).state == "done"
            assert answer(other, 0) == answer(one, 0) == before
            shadow = one.get("/maps/default/shadow").json()
            assert (shadow["state"], shadow["table"]["totals"]["views"]) == ("ready", 4)

            other.post("/maps/default/shadow/switch").raise_for_status()
            for number in range(4):
                assert answer(other, number) == answer(one, number)
            assert answer(other, 0) != before
            recipes = {
                client.post("/query", content=photo(0), headers=JPEG).json()["recipe"] for client in (one, other)
            }
            assert recipes == {shadow["recipe"]["id"]}


def test_a_service_that_cannot_search_in_its_database_does_not_start(tmp_path: Path) -> None:
    started = subprocess.run(
        [sys.executable, "-m", "app.cli", "serve", "--data", str(tmp_path), "--encoder", "color", "--port", "0"],
        env={"PATH": "", "PYTHONPATH": "client", "REVISIT_INDEX": "pgvector"},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert started.returncode != 0
    assert "the database is a file of SQLite; set REVISIT_DATABASE" in started.stderr
    assert "Traceback" not in started.stderr
