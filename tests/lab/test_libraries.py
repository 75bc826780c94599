"""Studies say what they need, before they begin."""

import subprocess
import sys
from pathlib import Path

import pytest

from lab.evaluate import main
from lab.libraries import FOR_FITTING, FOR_REPORTS, for_studies, require
from schemas.errors import SetupError


def test_a_missing_library_is_named_with_what_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    require(FOR_REPORTS)
    with pytest.raises(SetupError, match=r"scipy.*pip install scipy.*\./revisit test"):
        require(FOR_FITTING)


def test_what_is_wrong_inside_a_library_is_not_hidden() -> None:
    with pytest.raises(ZeroDivisionError), for_studies():
        raise ZeroDivisionError


def test_an_evaluation_that_could_not_be_reported_does_not_begin(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for folder in ("database", "query"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "0.png").touch()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["aligned", "--root", str(tmp_path), "--no-service"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "matplotlib" in err


def test_help_needs_none_of_them() -> None:
    loaded = "import lab.evaluate, lab.calibrate, lab.ablate, sys; print(*{'matplotlib', 'scipy'} & set(sys.modules))"
    told = subprocess.run([sys.executable, "-W", "ignore", "-c", loaded], capture_output=True, text=True, check=True)
    assert told.stdout.split() == []
