"""What the command line says of a data set: numbers that mean nothing are refused before anything is read."""

import argparse
from pathlib import Path

import pytest

from lab import ablate, decide, drives, loops
from lab.datasets.choosing import add_dataset_arguments, read
from lab.evaluate import main
from schemas.errors import InvalidParameters
from tests.lab.datasets.drawn import image


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("gap", "-5"),
        ("every", "0"),
        ("every", "-1"),
        ("radius", "-1"),
        ("radius", "0"),
        ("radius", "nan"),
        ("radius", "wide"),
        ("hold-out", "1"),
        ("hold-out", "-0.1"),
        ("heading", "-5"),
        ("heading", "200"),
        ("queries", "-3"),
        ("database", "0"),
        ("tolerance", "-1"),
        ("seed", "-1"),
        ("examples", "-1"),
    ],
)
def test_numbers_that_mean_nothing_are_refused(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["kitti", "--root", "anywhere", f"--{option}={value}"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"argument --{option}: {value!r} is no" in said


def test_a_set_is_called_by_its_folder_from_within_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("database", "query"):
        image(tmp_path / "campus" / name / "a.png")
    monkeypatch.chdir(tmp_path / "campus" / "query")
    assert main(["aligned", "--root", "..", "--truth-only"]) == 0
    monkeypatch.chdir(tmp_path / "campus")
    assert main(["aligned", "--root", ".", "--truth-only"]) == 0
    assert capsys.readouterr().out.count("campus query -> database: 1 queries") == 2


def of(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_dataset_arguments(parser)
    return parser.parse_args(arguments)


def test_what_cannot_be_held_out_is_said(tmp_path: Path) -> None:
    for i in range(4):
        image(tmp_path / "sequences" / "00" / "image_2" / f"{i}.png", i)
    (tmp_path / "poses").mkdir()
    (tmp_path / "poses" / "00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 4)
    options = of("kitti", "--root", str(tmp_path), "--hold-out", "0.3")
    with pytest.raises(InvalidParameters, match="hold-out: kitti 00 loop closure: images cannot be held out"):
        read("kitti", options)


@pytest.mark.parametrize("command", [decide.main, drives.main, loops.main, ablate.main])
def test_a_study_takes_no_option_that_it_does_not_heed(
    command: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert callable(command)
    for ignored in ("--url=http://127.0.0.1:1", "--truth-only", "--baselines=none"):
        with pytest.raises(SystemExit):
            command(["pairs", "--root", str(tmp_path), ignored])
        assert f"unrecognized arguments: {ignored}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--preset", "nope"], "'nope' is not one of"),
        (["--sets", "south"], "sets: south begins no name of"),
        (["--sizes", "few"], "argument --sizes: 'few' is no whole number of 1 or more"),
        (["--others", "-1"], "argument --others: '-1' is no whole number of 0 or more"),
    ],
)
def test_decisions_say_what_is_wrong(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("REVISIT_ENCODER", "color")
    for name in ("database", "query"):
        for i in range(4):
            image(tmp_path / name / f"{i}.png", i)
    try:
        code = decide.main(["aligned", "--root", str(tmp_path), "--out", str(tmp_path / "out"), *arguments])
    except SystemExit as ended:
        code = ended.code  # type: ignore[assignment]
    assert code == 2
    assert said in capsys.readouterr().err


def test_no_part_of_the_method_has_such_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        ablate.main(["aligned", "--root", str(tmp_path), "--variants", "nope"])
    assert "--variants nope names none of: default, " in capsys.readouterr().err


@pytest.mark.parametrize("study", [drives.main, loops.main])
def test_studies_of_walks_say_that_there_are_none(
    study: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert callable(study)
    for name in ("database", "query"):
        for i in range(4):
            image(tmp_path / "campus" / name / f"{i}.png", i)
    given = ["aligned", "--root", str(tmp_path / "campus"), "--tolerance", "0"]
    assert study(given) == 2
    assert "no walk, whose neighbouring queries share right answers, is among campus" in capsys.readouterr().err
    assert study([*given, "--sets", "south"]) == 2
    assert "sets: south begins no name of campus" in capsys.readouterr().err
