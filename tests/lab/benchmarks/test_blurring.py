import json
from pathlib import Path

import cv2
import numpy as np

from lab.benchmarks.blurring import coverage, labelled, recognised
from lab.evaluation.in_process import runtime_for_measuring
from schemas.settings import MEGA, Settings
from tests.lab.benchmarks.test_refreshing import walk
from worker.encoders.color import COLORS
from worker.service.blurring import Blurring


def test_what_is_covered_is_compared_with_labels(tmp_path: Path) -> None:
    (tmp_path / "classes.json").write_text(json.dumps({"0": ["building"], "9": ["cyclist", "rider"]}))
    for name in ("images", "labels"):
        (tmp_path / "test" / name).mkdir(parents=True)
    pixels = np.full((120, 160, 3), COLORS["building"], np.uint8)
    truth = np.zeros((120, 160), np.uint8)
    pixels[30:90, 40:80], truth[30:90, 40:80] = COLORS["cyclist"], 9
    truth[90:110, 120:150] = 9  # one that cannot be seen
    truth[:10] = 255
    assert cv2.imwrite(str(tmp_path / "test/images/a.png"), cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    assert cv2.imwrite(str(tmp_path / "test/labels/a.png"), truth)

    with runtime_for_measuring(Settings(encoder="color")) as runtime:
        blurring = Blurring(runtime.encoder, runtime.scheduler, MEGA)
        found = coverage(blurring, labelled(tmp_path / "test", "people"), "people")

    assert found.regions == 2
    assert (found.whole, found.less_than_half) == (0.5, 0.5)
    assert abs(found.pixels - 2400 / 3000) < 0.01
    assert 0 < found.rest < 0.1


def test_a_walk_is_recognised_with_and_without(tmp_path: Path) -> None:
    walks = [walk(tmp_path / "a", "noon", 0), walk(tmp_path / "b", "noon", 1)]
    with runtime_for_measuring(Settings(encoder="color")) as runtime:
        rows = recognised(runtime, walks)
    assert [row.name for row in rows] == ["as-sent", "blurred"]
    assert all(0 <= share <= 1 for row in rows for share in (row.recall, row.matched, row.right))
    assert all(row.enrol_ms > 0 for row in rows)
