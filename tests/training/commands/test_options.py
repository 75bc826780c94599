from pathlib import Path

import pytest

from training.commands.options import bfloat16_time_ratio
from training.commands.train import main

FILES = ["--data", "d", "--trunk", "t.npz", "--pretrained", "p.npz", "--out", "o"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--minutes", "1", "--labelled-views", "0"], "--labelled-views are at least 1"),
        ([], "say how long: --minutes or --steps"),
        (["--steps", "-2"], "say how long: --minutes or --steps, above 0"),
        (["--steps", "2"], "--trunk t.npz: there is no such file"),
    ],
)
def test_a_run_without_a_loss_or_a_length_is_refused(
    given: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main([*FILES, *given])
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_bfloat16_is_refused_where_the_processor_only_emulates_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("training.commands.options.bfloat16_time_ratio", lambda: 15.2)
    with pytest.raises(SystemExit):
        main([*FILES, "--minutes", "1", "--half"])
    assert "bfloat16 takes 15 times as long as float32 on this processor: leave --half out" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_what_would_fail_after_minutes_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def refused(*more: str) -> str:
        with pytest.raises(SystemExit):
            main([*FILES, "--steps", "2", *more])
        return capsys.readouterr().err

    Path("t.npz").touch()
    assert "--pretrained p.npz: there is no such file" in refused()
    Path("p.npz").touch()
    assert "--data d: there is no such folder" in refused()
    Path("d").mkdir()
    assert "--data d: there is no text/words_ViT-B-16.npz in it" in refused()
    Path("d/text").mkdir()
    Path("d/text/words_ViT-B-16.npz").touch()
    assert "--resume: there is no checkpoint.pt in o" in refused("--resume")
    Path("o").mkdir()
    Path("o/checkpoint.pt").write_bytes(b"hours of training")
    assert "--out o holds a run: go on with it by --resume" in refused()
    assert Path("o/checkpoint.pt").read_bytes() == b"hours of training"


def test_how_long_bfloat16_takes_is_measured() -> None:
    assert 0.02 < bfloat16_time_ratio() < 200
