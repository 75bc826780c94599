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


def test_how_long_bfloat16_takes_is_measured() -> None:
    assert 0.02 < bfloat16_time_ratio() < 200
