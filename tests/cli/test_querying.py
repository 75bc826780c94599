"""What the command line prints of answers, for people and for machines."""

import json
import urllib.parse
from pathlib import Path

import pytest

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "q.jpg"
    path.write_bytes(b"a picture")
    return path


def test_a_known_place(service: FakeService, image: Path, capsys: Out) -> None:
    other = answers.match(2, 0.3, place="canal", position=None)
    service.replies["POST /query"] = 200, answers.query_answer(answers.match(), other)

    assert main(["query", str(image), "--top", "2", "--near", "1,2,30"]) == 0

    text = capsys.readouterr().out
    assert text.startswith("This place is known. (confidence 0.93, 3 views searched)")
    lines = text.splitlines()
    assert lines[3].split()[:4] == ["1", "square", "0.800", "0.930"]
    assert "1.00, 2.00 m" in lines[3]
    assert lines[4].split()[1] == "canal"
    assert b"1.0,2.0,30.0" in service.requests[0][1]


def test_several_maps_are_told_apart(service: FakeService, image: Path, capsys: Out) -> None:
    facts = {"revision": 3, "recipe": "r", "ranking": "k", "searched": 3, "pending": 0}
    maps = [{"map": "floor1", "probability": 0.02, **facts}, {"map": "default", "probability": 0.93, **facts}]
    service.replies["POST /query"] = 200, answers.query_answer(answers.match()) | {"maps": maps}

    assert main(["query", str(image), "--maps", "floor1,default"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[3:5]] == [["floor1", "0.020", "3"], ["default", "0.930", "3"]]
    assert [line.split()[-1] for line in lines if "square" in line] == ["default"]
    assert b"floor1,default" in service.requests[0][1]
    with pytest.raises(SystemExit):
        main(["query", str(image), "--maps", "a,b", "--map", "c"])


def test_another_camera_is_told_to_the_service(service: FakeService, image: Path) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match())

    assert main(["query", str(image), "--zoom", "1.4", "--roll", "-12.5"]) == 0
    assert b'name="zoom"\r\n\r\n1.4\r\n' in service.requests[0][1]
    assert b'name="roll"\r\n\r\n-12.5\r\n' in service.requests[0][1]


def test_an_unknown_place_is_an_answer_too(service: FakeService, image: Path, capsys: Out) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(status="no_match")

    assert main(["query", str(image)]) == 0
    assert "not known" in capsys.readouterr().out


def test_the_answer_as_json_is_the_services(service: FakeService, image: Path, capsys: Out) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match())

    assert main(["query", str(image), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["matches"][0]["view"]["place"] == "square"


def test_why_is_drawn_into_a_file_once_the_answer_is_told(
    service: FakeService, image: Path, tmp_path: Path, capsys: Out
) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match())
    service.replies["GET /queries/q1/explanation.png"] = 200, b"a png"

    assert main(["query", str(image), "--explain", str(tmp_path / "why.png")]) == 0
    assert (tmp_path / "why.png").read_bytes() == b"a png"
    capsys.readouterr()
    assert main(["query", str(image), "--explain", str(tmp_path / "missing" / "why.png")]) == 1
    assert capsys.readouterr().out.startswith("This place is known.")


CHANGED = {
    "status": "compared",
    "detail": None,
    "since": "v1",
    "compared": 0.9,
    "similarity": 0.8,
    "changes": [
        {
            "kind": "gone",
            "label": "cabinet",
            "instead": "wall",
            "confidence": 0.75,
            "then": {"centre": [0.25, 0.5], "extent": [0.1, 0.2], "share": 0.021},
            "now": None,
        }
    ],
    "links": {"drawing": "/queries/q1/changes.png"},
}


def test_what_changed_is_told_and_drawn(service: FakeService, image: Path, tmp_path: Path, capsys: Out) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match()) | {"changes": CHANGED}
    service.replies["GET /queries/q1/changes.png"] = 200, b"a png"

    assert main(["query", str(image), "--changes", str(tmp_path / "changed.png")]) == 0
    told = capsys.readouterr().out
    assert "90 % of the photo could be compared" in told
    assert ["gone", "cabinet", "wall", "0.750", "0.25,", "0.50", "-", "2.1", "%"] in [
        line.split() for line in told.splitlines()
    ]
    assert (tmp_path / "changed.png").read_bytes() == b"a png"


def test_photos_that_cannot_be_compared_are_not_drawn(service: FakeService, image: Path, tmp_path: Path) -> None:
    nothing = {"status": "image-not-kept", "detail": "no photo", "changes": [], "links": {}, "compared": 0.0}
    service.replies["POST /query"] = 200, answers.query_answer(answers.match()) | {"changes": CHANGED | nothing}

    assert main(["query", str(image), "--changes", str(tmp_path / "changed.png")]) == 0
    assert not (tmp_path / "changed.png").exists()


def test_two_views_are_compared(service: FakeService, tmp_path: Path, capsys: Out) -> None:
    service.replies["GET /views/v2/changes"] = 200, CHANGED | {"changes": []}
    service.replies["GET /views/v2/changes.png"] = 200, b"a png"

    assert main(["changes", "v2", "--since", "v1", "--drawing", str(tmp_path / "changed.png")]) == 0
    assert "nothing changed that could be told" in capsys.readouterr().out
    assert (tmp_path / "changed.png").read_bytes() == b"a png"
    assert main(["changes", "v2", "--since", "v1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["since"] == "v1"


def test_a_point_in_the_south_and_every_filter_are_sent(service: FakeService, image: Path) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match())
    service.replies["GET /views"] = 200, {"views": [], "next": None}
    argv = ["--near", "-27.4,153.0,50", "--after", "2026-03-01T09:30:00Z", "--before", "2026-03-02T09:30:00Z"]
    argv += ["--metadata", "floor=2", "--metadata", "a=b=c", "--exclude-last", "30s", "--exclude", "v1, v2"]
    argv += ["--where", '{"x": {"$gte": 2}}']

    assert main(["query", str(image), *argv]) == 0
    assert main(["views", *argv, "--geo"]) == 0

    (_, body), (listed, _) = service.requests
    for part in (
        b"-27.4,153.0,50.0",
        b'"metadata.floor"',
        b'"metadata.a"',
        b"b=c",
        b"30s",
        b"v1,v2",
        b"2026-03-02T",
        b'{"x": {"$gte": 2}}',
    ):
        assert part in body
    assert b'name="frame"' not in body
    for text in (
        "near=-27.4%2C153.0%2C50.0",
        "frame=geo",
        "metadata.floor=2",
        "exclude=v1%2Cv2",
        "exclude_last=30s",
        "where=%7B%22x",
    ):
        assert text in listed


def test_a_view_is_changed(service: FakeService, capsys: Out) -> None:
    service.replies["PATCH /views/v1"] = 200, answers.view("v1", place="hall")

    assert main(["views", "v1", "--set", '{"place": "hall", "x": 1.5, "captured_at": null}']) == 0
    assert json.loads(service.requests[0][1]) == {"place": "hall", "x": 1.5, "captured_at": None}
    assert json.loads(capsys.readouterr().out)["place"] == "hall"
    assert main(["views", "--set", "{}"]) == main(["views", "v1", "--set", "[]"]) == 2


@pytest.mark.parametrize("argv", [["--geo"], ["--metadata", "floor"]])
def test_filters_that_say_nothing_are_wrong_use(image: Path, argv: list[str]) -> None:
    assert main(["query", str(image), *argv]) == 2


@pytest.mark.parametrize("argv", [["--near", "1,2"], ["--near", "a,b,c"], ["--near", "1_0,2,3"]])
def test_a_point_needs_three_numbers(image: Path, argv: list[str]) -> None:
    assert main(["query", str(image), *argv]) == 2


def test_a_missing_file_is_named(capsys: Out) -> None:
    assert main(["query", "missing.jpg"]) == 1
    assert "missing.jpg: No such file" in capsys.readouterr().err


def test_maps_as_a_table_and_as_json(service: FakeService, capsys: Out) -> None:
    campus = answers.map_facts("campus") | {"ranking": {"id": "k", "preset": "paper"}}
    service.replies["GET /maps"] = 200, {"maps": [campus]}

    assert main(["maps"]) == 0
    row = capsys.readouterr().out.splitlines()[2].split()
    assert (row[:2], row[-2:]) == (["campus", "3"], ["paper", "compact"])
    assert main(["maps", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["name"] == "campus"


def test_no_maps_says_how_to_begin(service: FakeService, capsys: Out) -> None:
    service.replies["GET /maps"] = 200, {"maps": []}

    assert main(["maps"]) == 0
    assert "./revisit enroll" in capsys.readouterr().out


def test_one_map_shows_its_labels(service: FakeService, capsys: Out) -> None:
    service.replies["GET /maps/campus"] = 200, answers.map_facts("campus")

    assert main(["maps", "campus"]) == 0
    assert "#4682b4" in capsys.readouterr().out


def test_a_map_is_deleted_by_name_only(service: FakeService, capsys: Out) -> None:
    service.replies["DELETE /maps/campus"] = 200, {"views": 3, "images": 2, "revision": None}

    assert main(["maps", "--delete"]) == 2
    assert main(["maps", "campus", "--delete"]) == 0
    assert "3 views, 2 images" in capsys.readouterr().out


def test_views_failed_ones_with_their_reason(service: FakeService, capsys: Out) -> None:
    failed = answers.view("v2", state="failed", failure={"code": "nothing-static", "detail": "all moves"})
    service.replies["GET /views"] = 200, {"views": [answers.view("v1"), failed], "next": None}

    assert main(["views", "--map", "campus"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("v1")
    assert "failed: nothing-static" in lines[3]
    assert "map=campus" in service.requests[0][0]


def test_a_view_is_written_to_files(service: FakeService, tmp_path: Path) -> None:
    service.replies["GET /views/v1"] = 200, answers.view("v1")
    service.replies["GET /views/v1/graph.png"] = 200, b"graph"
    service.replies["GET /views/v1/segmentation.png"] = 200, b"labels"

    argv = ["views", "v1", "--graph", str(tmp_path / "g.png"), "--segmentation", str(tmp_path / "s.png")]
    assert main(argv) == 0

    assert (tmp_path / "g.png").read_bytes() == b"graph"
    assert (tmp_path / "s.png").read_bytes() == b"labels"
    sent = [request for request, _ in service.requests]
    assert "GET /views/v1/graph.png?legend=true" in sent
    assert "GET /views/v1/segmentation.png?overlay=true&legend=true" in sent
    assert main(["views", "--graph", "x.png"]) == 2


def test_places(service: FakeService, capsys: Out) -> None:
    place = {"map": "default", "place": "square", "views": 2, "position": None, "last_enrolled_at": answers.NOON}
    service.replies["GET /places"] = 200, {"places": [place], "next": None}

    assert main(["places"]) == 0
    assert "square" in capsys.readouterr().out

    service.replies["GET /places"] = 200, {"places": [], "next": None}
    assert main(["places"]) == 0
    assert "`./revisit views`" in capsys.readouterr().out


def test_a_job_shows_its_progress(service: FakeService, capsys: Out) -> None:
    seen = iter([(1, 4), (2, 4), (4, 4), (0, 2), (2, 2)])

    def reply(_: bytes) -> tuple[int, object]:
        done, total = next(seen)
        state = "done" if (done, total) == (2, 2) else "running"
        return 200, answers.job(state, kind="vocabulary") | {"progress": {"done": done, "total": total}}

    service.replies["POST /maps/default/vocabulary"] = 202, answers.job("waiting", kind="vocabulary")
    service.replies[f"GET /jobs/{answers.JOB}"] = reply

    assert main(["vocabulary", "train"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "images" in line]
    what = "images, vocabulary of map default"
    assert lines == [*(f"{n}/4 {what}" for n in (1, 2, 3, 4)), *(f"{n}/2 {what}" for n in (1, 2))]


def test_a_deletion_tells_which_snapshots_are_left(service: FakeService, capsys: Out) -> None:
    left = {"id": "s1", "map": "campus", "created_at": None, "views": None}
    receipt = {"views": 1, "images": 1, "revision": 3, "snapshots": [left], "snapshots_of_others": 2}
    service.replies["DELETE /views/v1"] = 200, receipt
    service.replies["DELETE /maps/campus"] = 200, {**receipt, "snapshots": [], "snapshots_of_others": 0}
    assert main(["views", "v1", "--delete"]) == main(["maps", "campus", "--delete"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "deleted v1: 1 images; snapshots that may still have some of it: s1, 2 of other maps",
        "deleted campus: 1 views, 1 images",
    ]


def test_views_that_pass_filters_are_deleted_together(service: FakeService, capsys: Out) -> None:
    service.replies["DELETE /views"] = 200, {"views": 3, "images": 2, "revision": 9}
    added = '{"metadata.proposed_by": {"$exists": true}}'
    assert main(["views", "--map", "campus", "--where", added, "--delete"]) == 0
    assert capsys.readouterr().out == "deleted 3 views, 2 images\n"
    called = urllib.parse.unquote_plus(service.requests[0][0])
    assert called == f"DELETE /views?map=campus&where={added}"


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        ["--map", "campus"],
        ["--place", "hall"],
        ["--map", "campus", "--place", "hall", "--state", "failed"],
        ["--map", "campus", "--place", "hall", "--limit", "1"],
        ["v1", "--map", "depot"],
        ["v1", "--place", "hall"],
        ["v1", "--image", "v1.jpg"],
        ["v1", "--set", "{}"],
    ],
)
def test_a_deletion_that_would_reach_more_than_was_meant_is_refused(service: FakeService, wrong: list[str]) -> None:
    assert main(["views", *wrong, "--delete"]) == 2
    assert service.requests == []


def test_a_drive_and_its_silence_are_told(service: FakeService, image: Path) -> None:
    service.replies["POST /query"] = 200, answers.query_answer(answers.match())
    assert main(["query", str(image), "--drive", "robot-7", "--drive-timeout", "5"]) == 0
    sent = service.requests[0][1]
    assert b'name="drive"\r\n\r\nrobot-7' in sent
    assert b'name="drive_timeout"\r\n\r\n5.0' in sent


def test_a_map_is_told_to_refuse_poor_images(service: FakeService, capsys: Out) -> None:
    service.replies["PATCH /maps/campus"] = 200, answers.map_facts("campus")
    assert main(["maps", "campus", "--refuse-poor", "yes"]) == main(["maps", "campus", "--refuse-poor", "no"]) == 0
    assert [json.loads(body) for _, body in service.requests] == [{"refuse_poor": True}, {"refuse_poor": False}]
    assert main(["maps", "--refuse-poor", "yes"]) == main(["maps", "campus", "--refuse-poor", "no", "--delete"]) == 2


@pytest.mark.parametrize("limit", ["0", "-1"])
def test_no_views_at_all_are_wrong_use(service: FakeService, limit: str) -> None:
    assert main(["views", "--limit", limit]) == 2
    assert service.requests == []
