"""`./revisit loops`: a walk goes in, loops and a pose graph come out."""

import itertools
import json
import signal
import threading
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
    service.replies["GET /views"] = 200, {"views": [], "next": None}
    service.replies["POST /query"] = 200, answers.query_answer(answers.match(view_id="0"))
    numbers = itertools.count()
    service.replies["POST /enroll"] = lambda _: (201, answers.enrolled(view_id=str(next(numbers))))
    odometry = str(tmp_path / "odometry.csv")
    return ["loops", str(tmp_path / "*.jpg"), "--map", "walk", "--positions", odometry, "--consistent", "1"]


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
    assert table.read_text().splitlines()[1:] == ["1,0,0.93,3.0,0.222222,8.20702", "2,0,0.93,3.0,0.222222,8.20702"]
    assert [line.split("?")[0] for line, _ in service.requests] == [
        "GET /views",
        *["POST /query", "POST /enroll"] * 3,
    ]


@pytest.mark.parametrize("ending", [KeyboardInterrupt, None])
def test_what_was_found_before_an_early_end_is_written(
    walk: list[str], service: FakeService, tmp_path: Path, capsys: Out, ending: type[BaseException] | None
) -> None:
    table = tmp_path / "loops.csv"
    refusals, over = iter([False, False, True]), threading.Event()

    def refused_at_last(_: bytes) -> tuple[int, object]:
        if next(refusals):
            while ending is not None and not over.is_set():
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
                over.wait(5)  # again if it came just before the main thread began to wait for the answer
            return 507, answers.problem("storage-full", 507)
        return 200, answers.query_answer(answers.match(view_id="0"))

    service.replies["POST /query"] = refused_at_last
    # What shells start in the background ignores SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        ended = main([*walk, "--csv", str(table)])
    finally:
        over.set()
        signal.signal(signal.SIGINT, before)

    assert ended == (1 if ending is None else 130)
    assert table.read_text().splitlines()[1:] == ["1,0,0.93,5.0,0.08,8.20702"]
    assert "(2 keyframes)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("call", "code", "status"), [("POST /enroll", "conflict", 409), ("POST /query", "nothing-static", 422)]
)
def test_an_image_that_is_of_no_use_is_left_out_and_the_walk_goes_on(
    walk: list[str], service: FakeService, tmp_path: Path, capsys: Out, call: str, code: str, status: int
) -> None:
    """A frame that was saved twice, or a black one."""
    table, calls, usual = tmp_path / "loops.csv", itertools.count(), service.replies[call]

    def refusing(body: bytes) -> tuple[int, object]:
        if next(calls) == 1:
            return status, answers.problem(code, status)
        return usual(body) if callable(usual) else usual

    service.replies[call] = refusing

    assert main([*walk, "--csv", str(table)]) == 0

    told = capsys.readouterr()
    assert told.out.splitlines()[-1] == "1 loops among 2 images"
    assert f"left out {tmp_path / '1.jpg'}: " in told.err
    assert [line.split(",")[:2] for line in table.read_text().splitlines()[1:]] == [["2", "0"]]


@pytest.mark.parametrize("option", ["--g2o", "--csv"])
def test_a_file_that_cannot_be_written_is_named_before_the_walk(
    walk: list[str], service: FakeService, tmp_path: Path, capsys: Out, option: str
) -> None:
    for file in (tmp_path, tmp_path / "missing" / "file"):
        assert main([*walk, option, str(file)]) == 2
        assert f"{file}: cannot be written" in capsys.readouterr().err
    assert service.requests == []


def test_a_map_with_another_walk_is_refused(walk: list[str], service: FakeService, tmp_path: Path, capsys: Out) -> None:
    table = tmp_path / "loops.csv"
    service.replies["GET /views"] = 200, {"views": [answers.view(metadata={"keyframe": 0})], "next": None}

    assert main([*walk, "--csv", str(table)]) == 1

    assert "holds keyframes of another walk" in capsys.readouterr().err
    assert not table.exists()


def test_for_machines(walk: list[str], service: FakeService, capsys: Out) -> None:
    rows = itertools.count()
    drive = {"images": 1, "posterior": [], "nowhere": 0.1, "single_frame_status": "matched"}
    alone = answers.query_answer(answers.match(view_id="0"), status="ambiguous")
    service.replies["POST /query"] = lambda _: (200, alone | {"drive": drive | {"agreeing": next(rows)}})

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


@pytest.mark.parametrize("option", [("--consistent", "0"), ("--radius", "0"), ("--within", "-5")], ids="=".join)
def test_options_out_of_range(walk: list[str], service: FakeService, capsys: Out, option: tuple[str, str]) -> None:
    assert main([*walk, *option]) == 2

    assert "above 0" in (told := capsys.readouterr().err) or "1 or more" in told
    assert service.requests == []


def test_positions_are_finite(walk: list[str], service: FakeService, tmp_path: Path, capsys: Out) -> None:
    (tmp_path / "odometry.csv").write_text("file,x,y\n0.jpg,0,0\n1.jpg,nan,0\n2.jpg,0,0\n")

    assert main(walk) == 2

    assert "nan" in capsys.readouterr().err.lower()
    assert service.requests == []
