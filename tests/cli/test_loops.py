"""`./revisit loops`: a walk goes in, loops and a pose graph come out."""

import json
from pathlib import Path

import pytest

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService
from tests.sample_images import photo

Out = pytest.CaptureFixture[str]


@pytest.fixture
def walk(tmp_path: Path, service: FakeService) -> list[str]:
    """Three images with odometry; the service takes each for the place of the first."""
    for number in range(3):
        (tmp_path / f"{number}.jpg").write_bytes(photo(number))
    (tmp_path / "odometry.csv").write_text("file,x,y,heading\n0.jpg,0,0,0\n1.jpg,0,2,0\n2.jpg,0,0.5,180\n")
    service.replies["POST /query"] = 200, answers.query_answer(answers.match(metadata={"keyframe": 0}))
    service.replies["POST /enroll"] = 201, answers.enrolled()
    return ["loops", str(tmp_path / "*.jpg"), "--map", "walk", "--positions", str(tmp_path / "odometry.csv")]


def test_loops_are_named_and_written(walk: list[str], service: FakeService, tmp_path: Path, capsys: Out) -> None:
    graph, table = tmp_path / "graph.g2o", tmp_path / "loops.csv"

    assert main([*walk, "--g2o", str(graph), "--csv", str(table), "--radius", "3"]) == 0

    told = capsys.readouterr()
    assert told.out.splitlines() == [
        "1.jpg is where 0.jpg was (confidence 0.93, within 3.0 m)",
        "2.jpg is where 0.jpg was (confidence 0.93, within 3.0 m)",
        "2 loops among 3 images",
    ]
    assert "VERTEX_SE2 2 0.000000 0.500000 -1.570796" in graph.read_text()
    assert graph.read_text().count("EDGE_SE2") == 4
    assert table.read_text().splitlines()[1:] == ["1,0,0.93,3.0", "2,0,0.93,3.0"]
    assert [line.split("?")[0] for line, _ in service.requests] == ["POST /query", "POST /enroll"] * 3


def test_for_machines(walk: list[str], capsys: Out) -> None:
    assert main([*walk, "--consistent", "2", "--json"]) == 0

    printed = json.loads(capsys.readouterr().out)
    assert printed["keyframes"] == 3
    assert [(loop["keyframe"], loop["earlier"], loop["files"]) for loop in printed["loops"]] == [
        (1, 0, ["1.jpg", "0.jpg"]),
        (2, 0, ["2.jpg", "0.jpg"]),
    ]


@pytest.mark.parametrize(
    ("odometry", "said"),
    [("file,x,y\n0.jpg,0,0\n", "1.jpg"), ("file,lat,lon\n0.jpg,1,1\n1.jpg,1,1\n2.jpg,1,1\n", "no x and y")],
)
def test_every_image_needs_odometry(
    walk: list[str], service: FakeService, tmp_path: Path, capsys: Out, odometry: str, said: str
) -> None:
    (tmp_path / "odometry.csv").write_text(odometry)

    assert main(walk) == 2

    assert said in capsys.readouterr().err
    assert service.requests == []


def test_nobody_agrees_with_less_than_one(walk: list[str], capsys: Out) -> None:
    assert main([*walk, "--consistent", "0"]) == 2
    assert "--consistent" in capsys.readouterr().err
