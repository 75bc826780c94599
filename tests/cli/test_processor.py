"""A processor that is too old is named before a library ends the process."""

import platform
from pathlib import Path

import pytest

from app.cli import processor
from app.cli.__main__ import main

CORE2 = "processor\t: 0\nmodel name\t: Core 2\nflags\t\t: fpu sse2 ssse3 cx16 sse4_1 lahf_lm\nbugs\t\t: none\n"
NEHALEM = "processor\t: 0\nflags\t\t: fpu sse2 ssse3 cx16 sse4_1 sse4_2 popcnt lahf_lm\n"
ARM = "processor\t: 0\nFeatures\t: fp asimd\n"


@pytest.mark.parametrize(("text", "missing"), [(CORE2, ["popcnt", "sse4_2"]), (NEHALEM, []), (ARM, []), ("", [])])
def test_what_a_processor_lacks(text: str, missing: list[str]) -> None:
    assert processor.missing_instructions(text) == missing


@pytest.mark.parametrize("command", ["serve", "worker"])
def test_an_old_processor_is_named(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cpuinfo").write_text(CORE2)
    monkeypatch.setattr(processor, "CPUINFO", tmp_path / "cpuinfo")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")

    assert main([command, "--data", str(tmp_path / "data")]) == 1

    assert "lacks popcnt, sse4_2" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
