"""`./revisit import`: folders are packed while they are sent, errors are listed, wrong use sends nothing."""

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import pytest
from revisit_client.recordings import folder_as_zip

from app.cli.__main__ import main
from tests import answers
from tests.cli.fake_service import FakeService
from tests.sample_images import photo

Out = pytest.CaptureFixture[str]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    folder = tmp_path / "walk"
    (folder / "front").mkdir(parents=True)
    (folder / ".cache").mkdir()
    for number, name in enumerate(("front/1.jpg", "2.jpg", ".cache/3.jpg")):
        (folder / name).write_bytes(photo(number))
    (folder / "notes.txt").write_text("a fine day")
    return folder


def imported(**changes: Any) -> dict[str, Any]:
    report = {"images": 2, "enrolled": 2, "already_there": 0, "failed": 0, "errors": [], "errors_left_off": 0}
    return answers.job(kind="import", progress={"done": 2, "total": 2}, result=report | changes)


def replying(service: FakeService, **changes: Any) -> None:
    job = imported(**changes)
    service.replies[f"POST /maps/{job['map']}/imports"] = (
        202,
        job | {"state": "waiting", "progress": None, "result": None},
    )
    service.replies[f"GET /jobs/{job['id']}"] = 200, job


def packed(service: FakeService) -> zipfile.ZipFile:
    return zipfile.ZipFile(io.BytesIO(service.requests[0][1]))


def test_poses_go_along(service: FakeService, walk: Path) -> None:
    (walk / "groundtruth.txt").write_text("1 0 0 0 0 0 0 1\n")
    (walk / "slam.tum").write_text("1 0 0 0 0 0 0 1\n")
    replying(service)

    assert main(["import", str(walk), "--map", answers.job()["map"]]) == 0

    with packed(service) as archive:
        assert archive.namelist() == ["2.jpg", "front/1.jpg", "groundtruth.txt", "slam.tum"]


def test_a_name_that_is_not_utf_8_is_packed_as_what_can_be_read_of_it(service: FakeService, walk: Path) -> None:
    (walk / "2.jpg").rename(os.fsdecode(bytes(walk / "caf") + b"\xe9.jpg"))
    replying(service)

    assert main(["import", str(walk), "--map", answers.job()["map"]]) == 0

    with packed(service) as archive:
        assert archive.namelist() == ["caf%E9.jpg", "front/1.jpg"]


def test_a_folder_is_packed_and_its_errors_are_listed(service: FakeService, walk: Path, capsys: Out) -> None:
    name = answers.job()["map"]
    replying(service, enrolled=1, failed=1, errors=[{"file": "2.jpg", "problem": "bad-row", "detail": "x is 'far'"}])

    assert main(["import", str(walk), "--map", name]) == 1

    with packed(service) as archive:
        assert archive.namelist() == ["2.jpg", "front/1.jpg"]
        assert archive.read("front/1.jpg") == photo(0)
    printed = capsys.readouterr()
    assert printed.out == "1 enrolled, 0 already there, 1 failed\n"
    assert "2.jpg: x is 'far'" in printed.err


def test_a_manifest_from_elsewhere_goes_along(service: FakeService, walk: Path, tmp_path: Path, capsys: Out) -> None:
    (tmp_path / "poses.csv").write_text("file,x,y\n2.jpg,1,2\n")
    replying(service)
    command = ["import", str(walk), "--map", answers.job()["map"], "--manifest", str(tmp_path / "poses.csv")]

    assert main([*command, "--json"]) == 0

    with packed(service) as archive:
        assert archive.read("manifest.csv") == b"file,x,y\n2.jpg,1,2\n"
    assert json.loads(capsys.readouterr().out)["result"]["enrolled"] == 2


def test_the_folders_own_manifest_may_be_named_in_any_way(
    service: FakeService, walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (walk / "manifest.csv").write_text("file,x,y\n2.jpg,1,2\n")
    replying(service)
    monkeypatch.chdir(walk.parent)

    assert main(["import", str(walk), "--map", answers.job()["map"], "--manifest", f"{walk.name}/manifest.csv"]) == 0

    with packed(service) as archive:
        assert archive.namelist().count("manifest.csv") == 1


def test_an_archive_is_sent_as_it_is_and_need_not_be_waited_for(
    service: FakeService, tmp_path: Path, capsys: Out
) -> None:
    (tmp_path / "walk.zip").write_bytes(b"an archive")
    replying(service)

    assert main(["import", str(tmp_path / "walk.zip"), "--map", answers.job()["map"], "--no-wait"]) == 0

    assert [body for _, body in service.requests] == [b"an archive"]
    assert "waiting" in capsys.readouterr().out


def test_a_manifest_that_is_missing_is_told_before_anything_is_sent(walk: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"poses\.csv"):
        folder_as_zip(walk, tmp_path / "poses.csv")  # no piece of it was asked for


@pytest.mark.parametrize("arguments", [["empty"], ["walk.zip", "--manifest", "poses.csv"], ["walk", "--manifest", "p"]])
def test_what_cannot_be_sent_is_wrong_use(
    service: FakeService, walk: Path, tmp_path: Path, arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "walk.zip").write_bytes(b"an archive")
    (walk / "manifest.csv").write_text("file\n")
    monkeypatch.chdir(tmp_path)

    assert main(["import", *arguments]) == 2

    assert service.requests == []
