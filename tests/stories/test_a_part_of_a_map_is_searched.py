"""A building is one map, and a robot that knows its floor asks only there; the same words list and delete."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import RunningService

JPEG = {"content-type": "image/jpeg"}
SECOND = {"place": {"$prefix": "floor2/"}}
NEW = {"metadata.run": {"$gte": 3}}


@pytest.fixture
def client(tmp_path: Path) -> Any:
    with RunningService(tmp_path) as one, httpx.Client(base_url=one.url, timeout=60) as client:
        for number in range(6):
            known = {"place": f"floor{1 + number % 2}/door{number}", "metadata": json.dumps({"run": number})}
            assert client.post("/enroll", params=known, content=photo(number), headers=JPEG).status_code == 201
        yield client


def places(answer: httpx.Response) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [view["place"] for view in answer.json()["views"]]


def test_a_query_a_list_and_a_deletion_take_the_same_condition(client: httpx.Client) -> None:
    both = {"where": json.dumps({"$and": [SECOND, NEW]})}
    whole = client.post("/query", content=photo(2), headers=JPEG).json()
    upstairs = client.post("/query", params={"where": json.dumps(SECOND)}, content=photo(2), headers=JPEG).json()
    assert whole["matches"][0]["view"]["place"] == "floor1/door2"
    assert {match["view"]["place"][:7] for match in upstairs["matches"]} == {"floor2/"}
    assert (whole["searched"], upstairs["searched"]) == (6, 3)

    assert places(client.get("/views", params=both)) == ["floor2/door3", "floor2/door5"]
    assert client.delete("/views", params={"map": "default", **both}).json()["views"] == 2
    assert places(client.get("/views", params={"where": json.dumps(SECOND)})) == ["floor2/door1"]
    assert len(client.get("/views").json()["views"]) == 4


def test_where_nothing_fits_the_answer_says_so(client: httpx.Client) -> None:
    none = {"where": json.dumps({"metadata.run": {"$gt": 99}})}
    answer = client.post("/query", params=none, content=photo(2), headers=JPEG).json()
    assert (answer["status"], answer["reason"]["code"], answer["matches"]) == ("no_match", "empty", [])
