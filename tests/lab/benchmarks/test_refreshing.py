from pathlib import Path

import cv2

from lab.benchmarks.refreshing import Policy, measure
from lab.evaluation.in_process import runtime_for_measuring
from scenes import scene
from scenes.scene import Lighting
from schemas.settings import Settings

NAMES = ("mill lane", "rose garden")


def walk(folder: Path, light: Lighting, dx: float) -> list[Path]:
    folder.mkdir()
    found = []
    for number, name in enumerate(NAMES):
        path = folder / f"{number}.png"
        pixels = scene(name).at(light).seen_from(dx=dx).sized(160, 120).pixels
        assert cv2.imwrite(str(path), cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
        found.append(path)
    return found


def test_a_walk_is_enrolled_refreshed_and_queried(tmp_path: Path) -> None:
    walks = [walk(tmp_path / "a", "noon", 0), walk(tmp_path / "b", "dusk", 1), walk(tmp_path / "c", "night", 1)]
    with runtime_for_measuring(Settings(encoder="color")) as runtime:
        rows = measure(runtime, walks, 1, [Policy("all", 10, unconfirmed=True)])

    assert [row.name for row in rows] == ["none", "all"]
    assert rows[0].taken == 0
    assert 0 <= rows[1].wrong <= rows[1].taken <= len(NAMES)
    assert all(0 <= share <= 1 for row in rows for share in (row.recall, row.matched, row.right))
