"""`./revisit recipe` and `vocabulary`: what describes and ranks a map, shown and changed."""

import json

import pytest

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]


def test_a_recipe_is_shown_or_switched_and_waited_for(service: FakeService, capsys: Out) -> None:
    differs = [{"parameter": "ranking.candidates", "value": 7, "preset": 50}]
    facts = answers.map_facts() | {"ranking": {"id": "k", "preset": "default"}, "preset_differences": differs}
    service.replies["GET /maps/default"] = 200, facts
    service.replies["POST /maps/default/recipe"] = 202, answers.job("waiting", kind="recipe")
    service.replies[f"GET /jobs/{answers.JOB}"] = 200, answers.job("done", kind="recipe")

    assert main(["recipe", "--map", "default"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("map default, preset default\n\ndiffers from its preset\n")
    assert ["ranking.candidates", "7", "50"] in [line.split() for line in text.splitlines()]
    assert "\n\ndescribed by\n" in text
    assert "{" not in text
    assert main(["recipe", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["ranking"]["preset"] == "default"
    assert shown["recipe"] == facts["recipe"]
    assert shown["preset_differences"] == differs
    assert main(["recipe", "--preset", "paper", "--dynamic", "car, bus"]) == 0
    assert capsys.readouterr().out == "recipe of map default: done\n"
    assert json.loads(service.requests[2][1]) == {"preset": "paper", "dynamic": ["car", "bus"]}


def test_dynamic_labels_are_tried_first(service: FakeService, capsys: Out) -> None:
    most = [{"view": answers.view(filename="a.jpg"), "share": 0.4}]
    labels = [{"label": "car", "share": 0.1, "views": 2}]
    preview = {"map": "default", "views": 3, "before": 0.01, "after": 0.1, "nothing_left": 1}
    service.replies["GET /maps/default/dynamic"] = 200, preview | {"labels": labels, "most": most}

    assert main(["recipe", "--dynamic", "car", "--preview"]) == 0

    text = capsys.readouterr().out
    assert text.startswith("3 views; at most 10.0% of their area would be left out, 1.0% are now\n1 view would have")
    assert "car" in text
    assert "a.jpg" in text
    assert [line for line, _ in service.requests] == ["GET /maps/default/dynamic?dynamic=car"]
    assert main(["recipe", "--dynamic", "car", "--preview", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["nothing_left"] == 1
    assert main(["recipe", "--preview"]) == 2


def test_a_ranking_alone_changes_at_once(service: FakeService, capsys: Out) -> None:
    service.replies["PATCH /maps/default"] = 200, answers.map_facts()

    assert main(["recipe", "--ranking", '{"candidates": 100}', "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ranking"]["id"] == "def"
    assert [json.loads(body) for _, body in service.requests] == [{"ranking": {"candidates": 100}}]


@pytest.mark.parametrize("option", ["--parameters", "--ranking"])
@pytest.mark.parametrize("text", ["{", "[1]"])
def test_parameters_need_to_be_a_json_object(option: str, text: str) -> None:
    assert main(["recipe", option, text]) == 2


def test_a_vocabulary_that_cannot_be_trained_says_why(service: FakeService, capsys: Out) -> None:
    failed = answers.job("failed", kind="vocabulary", failure={"code": "conflict", "detail": "too few views"})
    service.replies["POST /maps/default/vocabulary"] = 202, answers.job("waiting", kind="vocabulary")
    service.replies[f"GET /jobs/{answers.JOB}"] = 200, failed

    assert main(["vocabulary", "train"]) == 1
    assert "too few views" in capsys.readouterr().err
