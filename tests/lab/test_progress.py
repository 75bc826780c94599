"""A run tells how far it is."""

import pytest

from lab.evaluation.progress import progress_bar


def test_without_a_terminal_each_tenth_is_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("a set") as tell:
        for done in range(1, 31):
            tell("enrolling", done, 30)
        tell("querying", 1, 1)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[0] == "a set: enrolling 3/30"
    assert len(err.splitlines()) == 11


def test_a_terminal_gets_bars(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with progress_bar("a [set]") as tell:
        for _ in range(2):
            for done in range(1, 31):
                tell("enrolling", done, 30)
        print("a report")
    out, err = capsys.readouterr()
    assert out == "a report\n"
    assert "30/30" in err
    assert "a [set]: enrolling" in err
