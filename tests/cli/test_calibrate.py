"""Labelled images are queried, judged and sent, and the report is shown."""

import json
from pathlib import Path
from typing import Any

import pytest

from app.cli.__main__ import main
from app.http.examples import CALIBRATION_REPORT
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]

POSITION = {"x": 10.0, "y": 0.0, "z": None, "lat": None, "lon": None, "alt": None, "heading": None}


@pytest.fixture
def site(service: FakeService, tmp_path: Path) -> FakeService:
    """A service that always answers with the square, at (10, 0)."""
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        (tmp_path / name).write_bytes(b"an image")
    facts = answers.map_facts("campus")
    facts["ranking"] = {"id": "k", "same_place_m": 5.0}
    place = {"map": "town", "place": "square", "position": POSITION, "probability": 0.9, "views": []}
    service.replies |= {
        "GET /maps/campus": (200, facts),
        "GET /places": (200, {"places": [_place("square"), _place("canal")], "next": None}),
        "POST /query": (200, answers.query_answer(answers.match()) | {"places": [place]}),
        "POST /maps/campus/calibration": (200, CALIBRATION_REPORT),
        "DELETE /maps/campus/calibration": (200, facts),
    }
    return service


def _place(name: str) -> dict[str, Any]:
    return {"map": "campus", "place": name, "views": 2, "position": None, "last_enrolled_at": answers.NOON}


def calibrated(site: FakeService, folder: Path, text: str, *options: str, name: str = "labels.csv") -> dict[str, Any]:
    """What was sent for a table."""
    (folder / name).write_text(text)
    assert main(["calibrate", str(folder / name), "--map", "campus", *options]) == 0
    body: dict[str, Any] = json.loads(next(b for path, b in site.requests if path == "POST /maps/campus/calibration"))
    return body


def test_first_places_are_judged_by_name(site: FakeService, tmp_path: Path, capsys: Out) -> None:
    body = calibrated(site, tmp_path, "file,place,block\na.jpg,square,1\nb.jpg,canal,1\nc.jpg,,2\n")

    labels = [(one["right"], one["known"], one["block"]) for one in body["observed"]]
    assert labels == [(True, True, "1"), (False, True, "1"), (False, False, "2")]
    assert body["observed"][0]["features"] == {"gap": 1.5, "level": 0.0}
    assert (body["recipe"], body["ranking"], body["dry_run"]) == ("r", "k", False)
    text = capsys.readouterr().out
    assert "240 labelled images: 150 first places right, 60 of unknown places" in text
    assert "0.969 (0.893 to 0.991; 62 of 64)" in text
    assert "17 (3 to 89; 1 of 60)" in text
    assert "decides from now on" in text


def test_and_by_position_within_a_distance(site: FakeService, tmp_path: Path) -> None:
    site.replies["GET /views"] = 200, {"views": [], "next": None}
    text = "file,x,y\na.jpg,14,0\nb.jpg,30,0\n"
    near = calibrated(site, tmp_path, text, "--dry-run")
    assert [(one["right"], one["known"]) for one in near["observed"]] == [(True, True), (False, False)]
    assert near["dry_run"]

    site.requests.clear()
    site.replies["GET /views"] = 200, {"views": [answers.view()], "next": None}
    text = "file,x,y\na.jpg,30,0\nb.jpg,40,0\n"
    wide = calibrated(site, tmp_path, text, "--within", "25")
    assert [(one["right"], one["known"]) for one in wide["observed"]] == [(True, True), (False, True)]
    assert any("near=40.0%2C0.0%2C25.0" in path for path, _ in site.requests)

    site.requests.clear()
    degrees = calibrated(site, tmp_path, "file,lat,lon\na.jpg,30,0\n")
    assert not degrees["observed"][0]["right"]  # the map is in metres


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("labels.csv", "sep=;\nfilename;easting;northing;block\na.jpg;14,0;0,5;1\nb.jpg;30,0;0,0;2\n"),
        ("labels.tsv", "file\tx\ty\tz\theading\tblock\na.jpg\t14\t.5\t3\t90\t1\nb.jpg\t30\t0\t\t\t2\n"),
        (
            "labels.jsonl",
            '{"file": "a.jpg", "x": 14, "y": 0, "block": 1}\n{"file": "b.jpg", "x": 30, "y": 0, "block": 2}\n',
        ),
    ],
    ids=["csv", "tsv", "jsonl"],
)
def test_tables_are_read_as_imports_read_them(site: FakeService, tmp_path: Path, name: str, text: str) -> None:
    site.replies["GET /views"] = 200, {"views": [], "next": None}
    body = calibrated(site, tmp_path, text, name=name)
    assert [(one["right"], one["known"], one["block"]) for one in body["observed"]] == [
        (True, True, "1"),
        (False, False, "2"),
    ]


def test_an_image_that_is_refused_is_left_out_and_told(site: FakeService, tmp_path: Path, capsys: Out) -> None:
    _, answer = site.replies["POST /query"]  # type: ignore[misc]
    broken = answers.problem("undecodable-picture", 422, title="The image is truncated or corrupt")

    def reply(body: bytes) -> tuple[int, Any]:
        return (422, broken) if b"half an image" in body else (200, answer)

    site.replies["POST /query"] = reply
    (tmp_path / "b.jpg").write_bytes(b"half an image")

    body = calibrated(site, tmp_path, "file,place\na.jpg,square\nb.jpg,square\nc.jpg,\n")

    assert [one["right"] for one in body["observed"]] == [True, False]
    assert f"left out {tmp_path / 'b.jpg'}: The image is truncated or corrupt" in capsys.readouterr().err


def test_without_any_image_that_is_taken_nothing_is_calibrated(site: FakeService, tmp_path: Path, capsys: Out) -> None:
    site.replies["POST /query"] = 422, answers.problem("nothing-static", 422)
    (tmp_path / "labels.csv").write_text("file,place\na.jpg,square\n")
    assert main(["calibrate", str(tmp_path / "labels.csv"), "--map", "campus"]) == 1
    assert "none of the labelled images" in capsys.readouterr().err


def test_a_map_that_is_gone_is_no_fault_of_an_image(site: FakeService, tmp_path: Path) -> None:
    site.replies["POST /query"] = 404, answers.problem("not-found", 404)
    (tmp_path / "labels.csv").write_text("file,place\na.jpg,square\n")
    assert main(["calibrate", str(tmp_path / "labels.csv"), "--map", "campus"]) == 1
    assert not [path for path, _ in site.requests if path.endswith("/calibration")]


def test_the_report_as_json_is_the_services(site: FakeService, tmp_path: Path, capsys: Out) -> None:
    calibrated(site, tmp_path, "file,place\na.jpg,square\n", "--json")
    assert json.loads(capsys.readouterr().out) == CALIBRATION_REPORT


def test_a_map_returns_to_the_shipped_calibration(site: FakeService, capsys: Out) -> None:
    assert main(["calibrate", "--forget", "--map", "campus"]) == 0
    assert "shipped" in capsys.readouterr().out
    assert site.requests == [("DELETE /maps/campus/calibration", b"")]


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("file\na.jpg\n", "the first line"),
        ("file,place,x,y\na.jpg,square,1,2\n", "the first line"),
        ("file,place,colour\na.jpg,square,red\n", "the first line"),
        ("file,place\n", "has 0 rows"),
        ("file,place\nmoon.jpg,square\n", "line 2: there is no file"),
        ("file,x,y\na.jpg,1,east\n", "line 2: y is 'east'"),
        ("file,x,y\na.jpg,,\n", "line 2: has no x and y"),
        ("file,place\na.jpg,square\na.jpg,canal\n", "lines 2 and 3 are both about a.jpg"),
        ("file,place\na.jpg,plaza\n", "no view of the map campus shows 'plaza'"),
    ],
)
def test_labels_that_cannot_be_used_are_refused_before_any_query(
    site: FakeService, tmp_path: Path, capsys: Out, text: str, wrong: str
) -> None:
    (tmp_path / "labels.csv").write_text(text)
    assert main(["calibrate", str(tmp_path / "labels.csv"), "--map", "campus"]) == 2
    assert wrong in capsys.readouterr().err
    assert not [path for path, _ in site.requests if path.startswith("POST")]


def test_labels_or_forget_but_not_both(tmp_path: Path, capsys: Out) -> None:
    assert main(["calibrate"]) == 2
    assert main(["calibrate", str(tmp_path / "labels.csv"), "--forget"]) == 2
    assert "either" in capsys.readouterr().err
