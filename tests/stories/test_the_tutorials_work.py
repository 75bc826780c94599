"""What the tutorials show is run as it stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import ROOT, RunningService

PAGE = ROOT / "docs" / "tutorials" / "museum-guide.md"
NAMES = ("mill lane", "the green", "school hill", "chapel row")


def test_the_museum_guide_knows_its_exhibits(tmp_path: Path) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(program.splitlines()) <= 35
    (tmp_path / "guide.py").write_text(program)
    for name in NAMES:
        folder = tmp_path / "exhibits" / name
        folder.mkdir(parents=True)
        (folder / "left.jpg").write_bytes(photo(scene(name).seen_from()))
        (folder / "text.txt").write_text(f"This is {name}.\n")
    (tmp_path / "visitor.jpg").write_bytes(photo(scene("chapel row").seen_from(dx=0.3, turn=2)))
    (tmp_path / "elsewhere.jpg").write_bytes(photo(scene("a street nobody enrolled").seen_from()))

    with RunningService(tmp_path / "data", REVISIT_ENCODER="compact") as service:

        def guide(*argv: str) -> str:
            path = os.pathsep.join([str(ROOT / "client"), str(ROOT)])
            env = {**os.environ, "REVISIT_URL": service.url, "PYTHONPATH": path}
            ran = subprocess.run(
                [sys.executable, "guide.py", *argv], cwd=tmp_path, env=env, capture_output=True, text=True, check=True
            )
            return ran.stdout.strip()

        assert guide("teach") == guide("teach") == f"{len(NAMES)} exhibits"
        assert guide("visitor.jpg") == "chapel row: This is chapel row."
        assert "This is" not in guide("elsewhere.jpg")
