"""The first command of a newcomer: what it prints is what the README shows."""

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.stories.running import ROOT

pytestmark = pytest.mark.one_database("a command that starts a service of its own")


def rows(text: str) -> list[tuple[str, ...]]:
    """Rows of the tables in a text, one for each line that begins with an image's name."""
    return [tuple(re.split(r"  +", line.strip())) for line in text.splitlines() if re.match(r"[\w-]+\.jpg  ", line)]


def test_the_demo_prints_what_the_readme_shows(tmp_path: Path) -> None:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("REVISIT_")}
    demo = subprocess.run(
        [sys.executable, "-m", "app.cli", "demo", "--output", str(tmp_path / "out")],
        cwd=ROOT,
        env=clean | {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert demo.returncode == 0, demo.stderr

    printed, shown = rows(demo.stdout), rows((ROOT / "README.md").read_text())

    assert len(shown) >= 3
    for row in shown:
        (same,) = [one for one in printed if one[0] == row[0]]
        assert [*same[:3], *same[5:]] == [*row[:3], *row[5:]]
        # Kernels of the network differ in the last digits from processor to processor.
        assert [float(number) for number in same[3:5]] == pytest.approx([float(n) for n in row[3:5]], abs=0.02)
    verdicts = Counter((row[-2], row[-1]) for row in printed)
    assert verdicts == {("matched", "yes"): 12, ("no match", "yes"): 2}
    (verdict,) = re.findall(r"^12 of 12 known places .*$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert verdict in demo.stdout
    assert len(list((tmp_path / "out").rglob("*.png"))) >= 12
