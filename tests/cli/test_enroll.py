"""Folders, globs, positions; what is there already, what is refused, what goes on later."""

import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image as PilImage
from revisit_client import Revisit

from app.cli import images
from app.cli.__main__ import main
from app.cli.output import Failure
from lab.faults.heics import heics
from tests import answers
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "photos" / "inner").mkdir(parents=True)
    for name in ("b.png", "a.PNG", "inner/c.png"):
        PilImage.new("RGB", (40, 40), "red").save(tmp_path / "photos" / name)
    (tmp_path / "photos" / "notes.txt").write_text("no picture")
    return tmp_path / "photos"


def names(paths: list[Path], folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in paths]


def test_a_folder_means_all_images_inside(folder: Path) -> None:
    assert names(images.find([str(folder)]), folder) == ["a.PNG", "b.png", "inner/c.png"]


def test_globs_are_understood_and_nothing_is_taken_twice(folder: Path) -> None:
    found = images.find([f"{folder}/*.png", f"{folder}/b.png", f"{folder}/**/c.png"])

    assert names(found, folder) == ["b.png", "inner/c.png"]


@pytest.mark.parametrize("name", ["missing.png", "missing-*.png", "empty"])
def test_nothing_there_is_wrong_use(folder: Path, name: str) -> None:
    (folder / "empty").mkdir()

    with pytest.raises(Failure) as caught:
        images.find([str(folder / name)])
    assert caught.value.code == 2


def test_images_are_enrolled_and_counted(service: FakeService, folder: Path, capsys: Out) -> None:
    created = iter([True, False, True])
    service.replies["POST /enroll"] = lambda _: (201, answers.enrolled(next(created)))

    assert main(["enroll", str(folder), "--map", "campus", "--place", "gate", "--parallel", "1"]) == 0

    assert capsys.readouterr().out == "2 enrolled, 1 already there, 0 failed, 1 skipped\n"
    assert len(service.requests) == 3
    assert all(b"campus" in body and b"gate" in body for _, body in service.requests)


def test_one_refused_image_does_not_stop_the_others(service: FakeService, folder: Path, capsys: Out) -> None:
    def reply(body: bytes) -> tuple[int, object]:
        if b'filename="b.png"' in body:
            return 422, answers.problem("undecodable-picture", 422, detail="cut off")
        return 201, answers.enrolled()

    service.replies["POST /enroll"] = reply

    assert main(["enroll", str(folder), "--json"]) == 1

    summary = json.loads(capsys.readouterr().out)
    assert summary["enrolled"] == 2
    assert summary["failed"][0]["file"].endswith("b.png")
    assert "cut off" in summary["failed"][0]["reason"]


def test_a_file_that_is_far_too_large_is_refused_unread(
    service: FakeService, folder: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, read = folder / "scan.tif", Path.read_bytes
    with scan.open("wb") as file:
        file.truncate(3 * 10**9)  # takes no room on the disk, and more than all memory if it is read

    def read_bytes(path: Path) -> bytes:
        assert path != scan
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    service.replies["POST /enroll"] = (201, answers.enrolled())

    assert main(["enroll", str(folder), "--json"]) == 1

    summary = json.loads(capsys.readouterr().out)
    assert summary["enrolled"] == 3
    assert [(one["file"], "has 3.0 GB" in one["reason"]) for one in summary["failed"]] == [(str(scan), True)]


def test_an_image_that_was_taken_and_not_described_counts_as_failed_alone(
    service: FakeService, folder: Path, capsys: Out
) -> None:
    failure = {"code": "internal", "detail": "the encoder ran out of memory"}
    states: Iterator[dict[str, Any]] = iter([{}, {"state": "failed", "failure": failure}, {}])
    service.replies["POST /enroll"] = lambda _: (201, answers.enrolled(**next(states)))

    assert main(["enroll", str(folder), "--parallel", "1"]) == 1

    out, err = capsys.readouterr()
    assert out == "2 enrolled, 0 already there, 1 failed, 1 skipped\n"
    assert "b.png: the encoder ran out of memory" in err


def test_an_image_whose_name_is_not_utf_8_is_enrolled_under_what_can_be_read_of_it(
    service: FakeService, folder: Path, capsys: Out
) -> None:
    (folder / "b.png").rename(os.fsdecode(bytes(folder / "caf") + b"\xe9.png"))
    service.replies["POST /enroll"] = lambda _: (201, answers.enrolled())

    assert main(["enroll", str(folder), "--parallel", "1"]) == 0

    assert capsys.readouterr().out.startswith("3 enrolled")
    assert [b'filename="caf%E9.png"' in body for _, body in service.requests] == [False, True, False]
    assert main(["enroll", str(folder), "--dry-run"]) == 0
    assert r"caf\udce9.png" in capsys.readouterr().out


def test_a_place_whose_folder_has_no_name_in_unicode_is_refused_alone(
    service: FakeService, folder: Path, capsys: Out
) -> None:
    (folder / "inner").rename(os.fsdecode(bytes(folder / "caf") + b"\xe9"))
    service.replies["POST /enroll"] = lambda _: (201, answers.enrolled())

    assert main(["enroll", str(folder), "--place-from-folder"]) == 1

    out, err = capsys.readouterr()
    assert out == "2 enrolled, 0 already there, 1 failed, 1 skipped\n"
    assert "is no Unicode, and cannot be sent" in err


def test_an_error_that_nobody_thought_of_leaves_out_no_image_in_silence(
    service: FakeService, folder: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ValueError("no such luck")

    monkeypatch.setattr(Revisit, "enroll", fails)

    assert main(["enroll", str(folder), "--parallel", "1"]) == 1
    assert "no such luck\n0 of 3 images are enrolled" in capsys.readouterr().err


@pytest.mark.usefixtures("nobody")
def test_a_service_that_is_gone_stops_it_and_says_how_to_go_on(folder: Path, capsys: Out) -> None:
    assert main(["enroll", str(folder)]) == 1

    assert "run the same command again" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("status", "code", "told"),
    [(401, "unauthorized", "REVISIT_KEY"), (403, "forbidden", ""), (507, "disk-full", ""), (502, "bad-gateway", "")],
)
def test_what_would_refuse_every_image_stops_it_at_once(
    service: FakeService, tmp_path: Path, capsys: Out, status: int, code: str, told: str
) -> None:
    for number in range(40):
        (tmp_path / f"{number}.png").write_bytes(b"an image")
    service.replies["POST /enroll"] = lambda _: (status, answers.problem(code, status, detail="no, never"))

    assert main(["enroll", str(tmp_path), "--parallel", "2"]) == 1

    assert len(service.requests) <= 2
    err = capsys.readouterr().err
    assert "no, never" in err
    assert told in err
    assert "0 of 40 images are enrolled; run the same command again to go on" in err


def test_an_interrupted_one_says_how_many_are_in(service: FakeService, folder: Path, capsys: Out) -> None:
    """CTRL-C while the second image is sent."""
    count, interrupted = iter(range(9)), threading.Event()

    def reply(body: bytes) -> tuple[int, Any]:
        if next(count) == 1:
            while not interrupted.is_set():
                signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
                interrupted.wait(5)  # again if it came just before the main thread began to wait for the answer
            time.sleep(0.5)
        return 201, answers.enrolled()

    def interrupt(*_: object) -> None:
        interrupted.set()
        raise KeyboardInterrupt

    service.replies["POST /enroll"] = reply
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        assert main(["enroll", str(folder), "--parallel", "1"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)

    told = capsys.readouterr()
    assert "1 of 3 images are enrolled, and those that were being sent may be; run the same command again" in told.err
    assert told.err.endswith("revisit: interrupted\n")


def test_photos_of_phones_are_sent_as_they_are(service: FakeService, folder: Path, capsys: Out) -> None:
    (folder / "IMG_1.HEIC").write_bytes(heics()["plain"])
    service.replies["POST /enroll"] = 201, answers.enrolled()

    assert main(["enroll", str(folder)]) == 0

    assert capsys.readouterr().out.startswith("4 enrolled, ")
    assert any(heics()["plain"] in body for _, body in service.requests)


def test_what_is_skipped_is_named_with_its_reason(service: FakeService, folder: Path, capsys: Out) -> None:
    (folder / "clip.gif").write_bytes(b"GIF89a")
    (folder / "gone.png").symlink_to(folder / "nowhere.png")
    os.mkfifo(folder / "live.jpg")
    service.replies["POST /enroll"] = 201, answers.enrolled()

    assert main(["enroll", str(folder)]) == 0

    told = capsys.readouterr()
    assert told.out == "3 enrolled, 0 already there, 0 failed, 4 skipped\n"
    assert f"skipped {folder / 'notes.txt'}: .txt is no ending of an image" in told.err
    assert f"skipped {folder / 'clip.gif'}: .gif is no ending of an image" in told.err
    assert f"skipped {folder / 'gone.png'}: the link leads nowhere" in told.err
    assert f"skipped {folder / 'live.jpg'}: it is a pipe" in told.err
    assert main(["enroll", str(folder), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["skipped"]) == 4


def test_what_is_hidden_in_a_folder_is_left_out(service: FakeService, folder: Path, capsys: Out) -> None:
    (folder / "._a.jpg").write_bytes(b"what macOS leaves beside an image")
    for name in (".git/annex/objects", ".thumbnails"):
        (folder / name).mkdir(parents=True)
        (folder / name / "b.jpg").write_bytes(b"\xff\xd8\xff")
    service.replies["POST /enroll"] = 201, answers.enrolled()

    assert main(["enroll", str(folder), "--dry-run"]) == 0
    told = capsys.readouterr()
    assert "\n3 would be enrolled\n" in told.out
    assert "/." not in (told.out + told.err).replace(str(folder), "")
    assert main(["enroll", str(folder / ".thumbnails"), "--dry-run"]) == 0  # it was named
    assert capsys.readouterr().out.endswith("\n1 would be enrolled\n")


def test_a_link_has_its_own_name_and_folder(tmp_path: Path, capsys: Out) -> None:
    """As of git-annex and DVC, whose folders hold links: by the files behind them the positions were exchanged."""
    (tmp_path / "store").mkdir()
    (walk := tmp_path / "walks" / "hall").mkdir(parents=True)
    for name, kept in (("1", "2"), ("2", "1")):
        (tmp_path / "store" / f"{kept}.png").write_bytes(b"")
        (walk / f"{name}.png").symlink_to(tmp_path / "store" / f"{kept}.png")
    (positions := tmp_path / "poses.csv").write_text("file,x,y\n1.png,10,0\nhall/2.png,20,0\n")

    assert main(["enroll", f"{walk}/../hall", "--place-from-folder", "--positions", str(positions), "--dry-run"]) == 0

    told = [line.split("  ")[1:] for line in capsys.readouterr().out.splitlines()]
    assert told[:2] == [["place=hall", "x=10.0", "y=0.0"], ["place=hall", "x=20.0", "y=0.0"]]


def test_a_position_and_metadata_for_all_and_a_dry_run(service: FakeService, folder: Path, capsys: Out) -> None:
    service.replies["POST /enroll"] = 201, answers.enrolled()
    argv = [
        "enroll",
        str(folder / "b.png"),
        "--x",
        "-1.5",
        "--y",
        "2",
        "--heading",
        "360",
        "--metadata",
        '{"floor": 2}',
    ]

    assert main([*argv, "--dry-run"]) == 0
    assert service.requests == []
    assert capsys.readouterr().out.splitlines() == [
        f"{folder / 'b.png'}  x=-1.5  y=2.0  heading=360.0  metadata={{'floor': 2}}",
        "1 would be enrolled",
    ]
    assert main(argv) == 0
    body = service.requests[0][1]
    assert all(part in body for part in (b"-1.5", b"360.0", b'{"floor": 2}'))
    assert main(["enroll", str(folder), "--x", "1"]) == 2
    assert main(["enroll", str(folder), "--metadata", "floor 2"]) == 2


def test_a_missing_file_and_a_missing_table_are_both_wrong_use(folder: Path, capsys: Out) -> None:
    photo, table = str(folder / "none.png"), str(folder / "none.csv")
    for missing, argv in ((photo, [photo]), (table, [str(folder), "--positions", table])):
        assert main(["enroll", *argv]) == 2
        assert capsys.readouterr().err == f"revisit: {missing}: there is no such file or folder\n"


def test_the_folder_can_name_the_place(service: FakeService, folder: Path) -> None:
    service.replies["POST /enroll"] = 201, answers.enrolled()

    main(["enroll", str(folder / "inner"), "--place-from-folder"])

    assert b"inner" in service.requests[0][1]


def positions(folder: Path, text: str) -> images.Positions:
    path = folder / "positions.csv"
    path.write_text(text)
    return images.Positions(path)


def test_rows_belong_to_the_images_whose_path_they_end(folder: Path) -> None:
    table = positions(folder, "file,x,y,place\nb.png,1,2.5,door\ninner/c.png,3,4,\nelse.png,0,0,\n")

    assert table.of(folder / "b.png") == {"x": 1.0, "y": 2.5, "place": "door"}
    assert table.of(folder / "inner" / "c.png") == {"x": 3.0, "y": 4.0}
    assert table.of(folder / "a.PNG") is None
    assert table.unused() == ["else.png"]


@pytest.mark.parametrize(
    "text", ["", "x,y\n1,2\n", "file\na.png\n", "file,x,speed\na,1,2\n", "file,x,y\na,one,2\n", "file,x,y\na,nan,2\n"]
)
def test_positions_that_cannot_be_used_are_wrong_use(folder: Path, text: str) -> None:
    with pytest.raises(Failure) as caught:
        positions(folder, text)
    assert caught.value.code == 2


def test_positions_travel(service: FakeService, folder: Path, capsys: Out) -> None:
    service.replies["POST /enroll"] = 201, answers.enrolled()
    (folder / "p.csv").write_text("file,lat,lon,heading\nb.png,48.5,11.25,90\n")

    assert main(["enroll", str(folder), "--positions", str(folder / "p.csv"), "--parallel", "1"]) == 0

    bodies = {b'filename="b.png"' in body: body for _, body in service.requests}
    assert b"48.5" in bodies[True]
    assert b"11.25" in bodies[True]
    assert b'name="lat"' not in bodies[False]
    assert "2 of 3 images are not in" in capsys.readouterr().err
