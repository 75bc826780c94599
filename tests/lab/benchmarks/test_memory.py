"""The benchmark of memory runs, small; what it takes from the environment are settings that memory depends on."""

import re
from pathlib import Path

import pytest

from lab.benchmarks.memory import TRIED, main
from schemas.settings import read_settings


@pytest.mark.slow
def test_each_kind_of_caller_is_answered(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("REVISIT_DECODERS", raising=False)
    monkeypatch.setenv("REVISIT_ENCODER", "color")
    monkeypatch.setenv("REVISIT_DATA", str(tmp_path / "mine"))
    kinds = ("turns", "drawings", "comparisons", "stopped", "slow")
    main(["--kinds", *kinds, "--callers", "2", "--megapixels", "0.1", "--seconds", "3"])
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert head.endswith("REVISIT_ENCODER=color")
    assert not (tmp_path / "mine").exists(), "the user's own data are left alone"
    found = [re.fullmatch(r" +(\d) +(\w+) +([\d.]+) +(\d+) MB +(\d+) MB  (.*)", row) for row in rows]
    told = {row[2]: row for row in found if row is not None}
    assert tuple(told) == kinds
    assert len(rows) == len(told), "loads that are the same now are tried once"
    assert all(80 < int(row[4]) < 2000 and 20 < int(row[5]) < 1000 for row in told.values())
    assert re.fullmatch(r"\d+ x 200, \d+ x 201", told["turns"][6])
    for kind in ("drawings", "comparisons"):
        assert re.fullmatch(r"\d+ x 200", told[kind][6])
    assert told["stopped"][6] == "2 x none yet"


def test_what_is_measured_by_itself_are_the_usual_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("REVISIT_DECODERS", raising=False)
    tried, usual = (read_settings(given, data=tmp_path) for given in (TRIED, {"REVISIT_ENCODER": "compact"}))
    assert tried.model_dump() == usual.model_dump()
