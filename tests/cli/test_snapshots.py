"""`revisit snapshot` and `revisit restore`: through a running service, and on the data folder of a stopped one."""

import json
from pathlib import Path

import pytest
from revisit_client import Revisit, RevisitProblem

from app.cli.__main__ import main
from tests.sample_images import drawn, encoded
from tests.stories.running import RunningService

Out = pytest.CaptureFixture[str]


def test_maps_are_fetched_and_restored_on_both_ways(
    tmp_path: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    backup = tmp_path / "backup"
    backup.mkdir()
    stopped = tmp_path / "stopped"
    with RunningService(tmp_path / "data") as service, Revisit(service.url) as revisit:
        monkeypatch.setenv("REVISIT_URL", service.url)
        for name in ("campus", "depot"):
            revisit.enroll(encoded(drawn(96, 72, 1), "jpeg"), map=name, place="gate")
        assert main(["snapshot", "--all", "--output", str(backup), "--json"]) == 0
        made = json.loads(capsys.readouterr().out)
        files = sorted(backup.iterdir())
        assert [one["map"] for one in made] == ["campus", "depot"]
        assert [one["file"] for one in made] == list(map(str, files))
        assert revisit.snapshots() == []

        assert main(["snapshot", "campus", "--output", str(tmp_path / "one"), "--keep"]) == 0
        (kept,) = revisit.snapshots()
        assert kept.map == "campus"
        capsys.readouterr()
        assert main(["snapshot", "--list"]) == 0
        assert capsys.readouterr().out.splitlines()[2].split()[:3] == [kept.id, "campus", "1"]
        assert main(["snapshot", "--fetch", kept.id, "--output", str(tmp_path / "again")]) == 0
        assert (tmp_path / "again").read_bytes() == (tmp_path / "one").read_bytes()
        assert main(["snapshot", "--fetch", "none"]) == 1
        assert "--list" in capsys.readouterr().err
        with pytest.raises(FileExistsError):
            revisit.download_snapshot(revisit.snapshots()[0].id, tmp_path / "one")

        with pytest.raises(RevisitProblem, match="exists already"):
            revisit.restore(tmp_path / "one")
        assert main(["restore", str(tmp_path / "one"), "--url", service.url, "--as", "copy"]) == 0
        assert "with new ids" in capsys.readouterr().out
        assert revisit.map("copy").views["ready"] == 1
        assert main(["restore", str(tmp_path / "one"), "--data", str(tmp_path / "data")]) == 1
        assert "--url" in capsys.readouterr().err

        assert main(["snapshot", "--delete", kept.id]) == 0
        assert "removed" in capsys.readouterr().out
        assert revisit.snapshots() == []

    assert main(["restore", str(files[0]), "--data", str(stopped), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["map"] == "campus"
    assert main(["restore", str(files[0]), "--data", str(stopped)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["restore", str(files[0]), "--data", str(stopped), "--as", "copy"]) == 0
    assert f"restored the map copy in {stopped}: " in capsys.readouterr().out
    files[1].write_bytes(files[1].read_bytes()[:-700])
    assert main(["restore", str(files[1]), "--data", str(stopped)]) == 1
    assert "nothing was changed" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong",
    [
        ["snapshot"],
        ["snapshot", "campus", "--all"],
        ["snapshot", "campus", "--list"],
        ["snapshot", "--delete", "s1", "--keep"],
        ["snapshot", "--list", "--output", "here"],
        ["snapshot", "--all", "--output", "/nowhere"],
        ["restore", "f", "--as", "../x"],
        ["restore", "f", "--url", "http://127.0.0.1:9", "--data", "d"],
    ],
)
def test_wrong_use_is_told_before_anything_happens(wrong: list[str], nobody: None, capsys: Out) -> None:
    assert main(wrong) == 2
    assert capsys.readouterr().err


def test_a_folder_that_is_missing_is_told_and_no_file_is_called_so(tmp_path: Path, nobody: None, capsys: Out) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["snapshot", "campus", "--output", f"{tmp_path}/backup/"])

    assert caught.value.code == 2
    assert f"no folder {tmp_path}/backup/" in capsys.readouterr().err


def test_a_file_that_is_missing_is_named(tmp_path: Path, capsys: Out) -> None:
    assert main(["restore", str(tmp_path / "none"), "--data", str(tmp_path / "data")]) == 1
    assert "none" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "told"), [("nothing", "{path}: "), (".", "{path}: "), ("photo.jpg", "the snapshot is refused")]
)
def test_a_file_that_is_no_snapshot_makes_no_data_folder(tmp_path: Path, name: str, told: str, capsys: Out) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"a photo")
    data = tmp_path / "data"
    assert main(["restore", str(tmp_path / name), "--data", str(data)]) == 1
    assert capsys.readouterr().err.startswith(f"revisit: {told.format(path=tmp_path / name)}")
    assert not data.exists()


def test_the_help_of_restore_says_that_only_url_makes_it_call_a_service(capsys: pytest.CaptureFixture[str]) -> None:
    """With REVISIT_URL set it works on the data folder all the same: its help named that as the default."""
    with pytest.raises(SystemExit):
        main(["restore", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert "this address; REVISIT_URL says nothing here" in told
    assert "default: REVISIT_URL" not in told
