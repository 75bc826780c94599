"""What the command line begins, shows, switches to and discards of a map's shadow."""

import json
from typing import Any

import pytest

from app.cli.__main__ import main
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]
AT = "2026-05-01T10:00:00Z"
SIDE = {"matched": 1, "ambiguous": 0, "no_match": 1, "refused": 0, "right": 1, "search_ms": 4.5, "describe_ms": None}
ANSWER = {"confidence": 0.9, "score": 0.6, "search_ms": 4.5, "describe_ms": None, "right": True, "view": "v1"}


def row(name: str, old: str, new: str) -> dict[str, Any]:
    answers = {which: {**ANSWER, "status": status, "place": "gate"} for which, status in (("old", old), ("new", new))}
    return {"id": name, "source": "view", "place": "gate", "at": AT, "same_place": True, "agree": old == new, **answers}


TABLE = {
    "wanted": 5, "recipe": "n", "ranking": "r", "old_recipe": "o", "old_ranking": "r", "old_views": 9, "new_views": 8,
    "old_compared": 9, "new_compared": 8,
    "queries": [row("q1", "matched", "no_match"), row("q2", "matched", "matched")],
    "totals": {
        "queries": 2, "kept": 0, "views": 2, "agree": 1, "changed_first": 0, "became_matched": 0, "stopped_matching": 1,
        "known": 2, "old": {**SIDE, "matched": 2, "no_match": 0}, "new": SIDE,
    },
}  # fmt: skip
SHADOW = {
    "map": "campus", "state": "ready", "job": "s1", "progress": None, "wanted": 5, "recipe": {"id": "n"},
    "ranking": {"id": "r"}, "table": TABLE, "links": {},
}  # fmt: skip
JOB: dict[str, Any] = {
    "id": "s1", "kind": "shadow", "state": "done", "map": "campus", "view": None, "attempts": 1, "progress": None,
    "result": None, "created_at": AT, "finished_at": AT, "failure": None, "links": {},
}  # fmt: skip


@pytest.fixture
def shadowed(service: FakeService) -> FakeService:
    service.replies = {
        "POST /maps/campus/recipe": (202, JOB),
        "GET /jobs/s1": (200, JOB),
        "GET /jobs/s2": (200, {**JOB, "id": "s2", "kind": "recipe"}),
        "GET /maps/campus/shadow": (200, SHADOW),
        "POST /maps/campus/shadow/switch": (202, {**JOB, "id": "s2", "kind": "recipe", "state": "running"}),
        "DELETE /maps/campus/shadow": (200, JOB),
    }
    return service


def changes(service: FakeService) -> list[tuple[str, Any]]:
    return [(call, json.loads(body) if body else None) for call, body in service.requests if not call.startswith("GET")]


@pytest.mark.parametrize(("given", "sent"), [(["--shadow"], 100), (["--shadow", "7"], 7)])
def test_a_recipe_is_tried_in_the_shadow(shadowed: FakeService, capsys: Out, given: list[str], sent: int) -> None:
    assert main(["recipe", "--map", "campus", "--dynamic", "car", *given]) == 0
    assert changes(shadowed) == [("POST /maps/campus/recipe", {"dynamic": ["car"], "shadow": sent})]
    told = capsys.readouterr().out
    assert "2 queries, 0 kept ones and 2 views of the map; 1 agree" in told
    assert "q1" in told
    assert "q2" not in told
    assert "`./revisit shadow --map campus --switch` changes over" in told


def test_it_is_shown_as_text_and_as_json(shadowed: FakeService, capsys: Out) -> None:
    assert main(["shadow", "--map", "campus", "--all"]) == 0
    told = capsys.readouterr().out
    assert "matched 0.90: gate" in told
    assert "1 of 2" in told
    assert "q2" in told
    assert main(["shadow", "--map", "campus", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["table"]["totals"]["stopped_matching"] == 1
    shadowed.replies["GET /maps/campus/shadow"] = (
        200,
        {**SHADOW, "state": "describing", "table": None, "progress": {"done": 3, "total": 9}},
    )
    assert main(["shadow", "--map", "campus"]) == 0
    assert capsys.readouterr().out == "shadow of map campus: describing, 3 of 9 images\n"


@pytest.mark.parametrize(
    ("given", "sent", "told"),
    [
        ("--switch", "POST /maps/campus/shadow/switch", "map campus has changed over to its shadow\n"),
        ("--discard", "DELETE /maps/campus/shadow", "the shadow of map campus is discarded\n"),
    ],
)
def test_it_is_switched_to_or_discarded(shadowed: FakeService, capsys: Out, given: str, sent: str, told: str) -> None:
    assert main(["shadow", "--map", "campus", given]) == 0
    assert capsys.readouterr().out == told
    assert changes(shadowed) == [(sent, None)]
    assert main(["shadow", "--map", "campus", given, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "done"


def test_wrong_use(shadowed: FakeService, capsys: Out) -> None:
    for given in (["--shadow"], ["--shadow", "--ranking", "{}"], ["--dynamic", "car", "--preview", "--shadow"]):
        assert main(["recipe", "--map", "campus", *given]) == 2
    shadowed.replies["GET /maps/campus/shadow"] = 404, {"type": "urn:x:not-found", "title": "", "detail": "no shadow"}
    assert main(["shadow", "--map", "campus"]) == 1
    assert "no shadow" in capsys.readouterr().err
    assert changes(shadowed) == []
