from pathlib import Path

import pytest

from training.__main__ import main

FILES = ["--data", "d", "--trunk", "t.npz", "--pretrained", "p.npz", "--out", "o"]


@pytest.mark.parametrize(
    ("given", "said"),
    [(["--minutes", "1", "--clear", "0"], "--clear are at least 1"), ([], "say how long: --minutes or --steps")],
)
def test_a_run_that_could_teach_nothing_is_refused(
    given: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main([*FILES, *given])
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
