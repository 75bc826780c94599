"""The benchmark of a fleet runs, small, and prints its ratios."""

import re

import pytest

from lab.benchmarks.fleet import main
from tests.storage.databases import postgres_schema


@pytest.mark.slow
def test_two_workers_and_two_databases_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    with postgres_schema() as url:
        sizes = {"views": 60, "repeats": 3, "images": 30, "rounds": 1}
        further = [word for name, size in sizes.items() for word in (f"--{name}", str(size))]
        main(["--database", url, "--encoder", "color", *further])
    printed = capsys.readouterr().out
    ratios = [float(found) for found in re.findall(r"ratio ([\d.]+)", printed)]
    assert len(ratios) == 4
    assert all(0.1 < ratio < 10 for ratio in ratios)
    assert "postgresql: 60 views in" in printed
    checked = re.findall(r"revision, (\w+): median ([\d.]+) ms", printed)
    assert [kind for kind, _ in checked] == ["sqlite", "postgresql"]
    assert all(0 < float(ms) < 1000 for _, ms in checked)
