"""What the command line lists, names, takes and dismisses of the queries that a map kept."""

import json
from pathlib import Path
from typing import Any

import pytest

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]
AT = {"first_at": "2026-05-01T10:00:00Z", "last_at": "2026-05-02T10:00:00Z"}
SPOT = {"id": "u1", "count": 3, "queries": ["u1"], **AT, "links": {}}
PROPOSED = {"view": "v1", "count": 2, "queries": [], **AT, "lowest_score": 0.4, "highest_score": 0.5, "links": {}}


@pytest.fixture
def kept(service: FakeService) -> FakeService:
    proposals = [
        {**PROPOSED, "id": "p1", "place": "gate", "confirmed": 2},
        {**PROPOSED, "id": "p2", "place": None, "confirmed": 0},
    ]
    some = {"map": "campus", "kept": 5, "examined": 5}
    service.replies = {
        "GET /maps/campus/unknown": (200, {**some, "keep_queries": 9, "count": 1, "places": [SPOT]}),
        "GET /maps/campus/proposals": (200, {**some, "keep_matches": 0, "count": 2, "proposals": proposals}),
        "GET /maps/campus/unknown/u1/image": (200, b"u1"),
        "GET /maps/campus/proposals/p1/image": (200, b"p1"),
        "GET /maps/campus/proposals/p2/image": (200, b"p2"),
        "POST /maps/campus/unknown/u1": (200, {"views": [], "queries": 3}),
        "POST /maps/campus/proposals/p1": (200, {"views": [], "queries": 2}),
        "POST /maps/campus/proposals/p2": (200, {"views": [], "queries": 2}),
        "DELETE /maps/campus/unknown/u1": (200, {"queries": 3}),
        "DELETE /maps/campus/proposals/p2": (200, {"queries": 2}),
    }
    return service


def changes(service: FakeService) -> list[tuple[str, Any]]:
    return [(call, json.loads(body) if body else None) for call, body in service.requests if not call.startswith("GET")]


def test_what_is_kept_is_listed_and_its_images_saved(kept: FakeService, tmp_path: Path, capsys: Out) -> None:
    assert main(["inbox", "campus", "--images", str(tmp_path / "in")]) == 0
    told = capsys.readouterr()
    assert [line.split()[0] for line in told.out.splitlines() if line[:2] in ("u1", "p1", "p2")] == ["u1", "p1", "p2"]
    assert "view v1" in told.out
    assert "campus: 5 of at most 9 queries that matched nothing\n" in told.err
    assert "matched in another light; none are kept: `--keep 500` changes that" in told.err
    assert {path.name: path.read_bytes() for path in (tmp_path / "in").iterdir()} == {
        "u1.jpg": b"u1",
        "p1.jpg": b"p1",
        "p2.jpg": b"p2",
    }
    assert main(["inbox", "campus", "--json"]) == 0
    assert [one["id"] for one in json.loads(capsys.readouterr().out)["proposals"]["proposals"]] == ["p1", "p2"]


@pytest.mark.parametrize(
    ("given", "sent"),
    [
        (["--name", "u1", "dock"], [("POST /maps/campus/unknown/u1", {"place": "dock", "position": None})]),
        (
            ["--name", "u1", "dock", "--position", '{"x": 1.5, "y": 2}'],
            [("POST /maps/campus/unknown/u1", {"place": "dock", "position": {"x": 1.5, "y": 2}})],
        ),
        (["--accept", "confirmed"], [("POST /maps/campus/proposals/p1", {"views": 3, "unconfirmed": False})]),
        (
            ["--accept", "p2", "--unconfirmed", "--views", "1"],
            [("POST /maps/campus/proposals/p2", {"views": 1, "unconfirmed": True})],
        ),
        (["--dismiss", "u1"], [("DELETE /maps/campus/unknown/u1", None)]),
        (["--dismiss", "p2"], [("DELETE /maps/campus/proposals/p2", None)]),
    ],
)
def test_it_is_named_taken_or_dismissed(kept: FakeService, given: list[str], sent: list[tuple[str, Any]]) -> None:
    assert main(["inbox", "campus", *given]) == 0
    assert changes(kept) == sent


def test_machines_are_told_in_json_what_became_of_it(kept: FakeService, capsys: Out) -> None:
    for given, told in (
        (["--name", "u1", "dock"], {"views": [], "queries": 3}),
        (["--accept", "confirmed"], [{"views": [], "queries": 2}]),
        (["--dismiss", "p2"], {"queries": 2}),
    ):
        assert main(["inbox", "campus", *given, "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == told


def test_a_place_that_takes_no_more_does_not_keep_the_others_from_theirs(kept: FakeService, capsys: Out) -> None:
    full = answers.problem("conflict", 409) | {"detail": "the place has 10 views from proposals"}
    kept.replies["GET /maps/campus/proposals"][1]["proposals"][1]["confirmed"] = 2  # type: ignore[index]
    kept.replies["POST /maps/campus/proposals/p1"] = 409, full

    assert main(["inbox", "campus", "--accept", "confirmed"]) == 0

    assert [call for call, _ in changes(kept)] == [f"POST /maps/campus/proposals/{one}" for one in ("p1", "p2")]
    told = capsys.readouterr().err
    assert "gate: the place has 10 views from proposals" in told
    assert "views added to 1 places" in told
    assert main(["inbox", "campus", "--accept", "p1"]) == 1


def test_how_much_is_kept(kept: FakeService) -> None:
    kept.replies["PATCH /maps/campus"] = 404, {}
    assert main(["inbox", "campus", "--keep", "50"]) == 1
    assert changes(kept) == [("PATCH /maps/campus", {"keep_queries": 50, "keep_matches": 50})]


def test_what_is_not_there_is_said(kept: FakeService, capsys: Out) -> None:
    for given in (["--accept", "p9"], ["--dismiss", "p9"]):
        assert main(["inbox", "campus", *given]) == 1
        assert "p9; `revisit inbox campus` lists" in capsys.readouterr().err
    assert main(["inbox", "campus", "--unconfirmed"]) == 2
    assert main(["inbox", "campus", "--position", '{"x": 1, "y": 2}']) == 2
    assert changes(kept) == []
