"""Other verification of the first ten: seeded, and judged by rules that were learned elsewhere."""

from pathlib import Path

import numpy as np
import pytest

from lab.baselines.two_views import fundamental
from lab.benchmarks import geometry, scale
from lab.benchmarks.geometry import VARIANTS, Features, TopTen
from schemas.image import Bytes2D
from tests.lab.baselines.test_two_views import through_two_cameras
from tests.sample_images import drawn, encoded

[VARIANT, *_] = VARIANTS


def ten(base: list[float], inliers: list[float], right: int) -> TopTen:
    """A query of which the service saw these scores and inliers, a third of the matches, nowhere in particular."""
    counted = np.column_stack([inliers, 3 * np.array(inliers), np.full(len(inliers), 0.5)])
    return TopTen(np.array(base), np.arange(len(base)) == right, dict.fromkeys(VARIANTS, counted))


def test_a_fundamental_matrix_holds_points_in_depth_where_one_plane_does_not() -> None:
    source, target = through_two_cameras(60, 20)
    assert geometry.affine(source, target)[:60].mean() < 0.9
    assert fundamental(source, target)[:60].mean() > 0.9


def test_small_images_are_not_enlarged_beyond_what_the_service_does() -> None:
    small: Bytes2D = drawn(96, 72, 1)
    np.testing.assert_array_equal(Features(100, 640).of(small).descriptors, Features(100, 320).of(small).descriptors)


def test_inliers_that_decide_are_learned_and_inliers_that_mislead_are_not() -> None:
    telling = [ten([0.5, 0.49, 0.3], [4, 60, 5], 1), ten([0.5, 0.3, 0.49], [4, 5, 70], 2)] * 5
    misleading = [ten([0.5, 0.3], [4, 60], 0), ten([0.3, 0.5], [50, 5], 1)] * 5
    weights = geometry.learn([telling], VARIANT)
    assert geometry.first_right(telling, geometry.linear(VARIANT, weights)).all()
    assert not geometry.first_right(telling, lambda one: one.base).any()
    against = geometry.learn([misleading], VARIANT)
    assert (against >= 0).all(), "more evidence never counts against a view"
    assert geometry.first_right(misleading, geometry.linear(VARIANT, against)).all()


def test_separation_is_the_share_of_pairs_in_order() -> None:
    assert geometry.separation([ten([1, 1, 1], [9, 5, 5], 0)], VARIANT) == 1
    assert geometry.separation([ten([1, 1, 1], [5, 5, 9], 0)], VARIANT) == 0.25


def test_the_tables_of_two_sites(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for site in range(2):
        folder = tmp_path / "data" / "places" / f"site{site}"
        rows = ["query_folder,query_file,database_folder,database_file"]
        for place in range(2):
            pixels = drawn(96, 72, 10 * site + place)
            for moment, shown in (("query", pixels // 10 * 9), ("database", pixels)):
                (folder / moment).mkdir(parents=True, exist_ok=True)
                (folder / moment / f"{place}.jpg").write_bytes(encoded(shown))
            rows.append(f"query,{place}.jpg,database,{place}.jpg")
        (folder / "ground_truth.csv").write_text("\n".join(rows))
    data, cache, out = (str(tmp_path / name) for name in ("data", "cache.sqlite", "counts.json"))
    scale.main(["describe", "--data", data, "--cache", cache, "--encoder", "color", "--scenes", "0"])
    arguments = ["--data", data, "--cache", cache, "--encoder", "color", "--out", out]
    geometry.main(arguments)
    told = capsys.readouterr().out
    assert "site0 query -> database (2)" in told
    assert "| without verification | 100.0 | 100.0 | 100.0 |" in told
    geometry.main(arguments)
    again = capsys.readouterr().out
    assert "queries," not in again, "counts that are kept are not made again"
    assert _table(again) == _table(told)


def _table(told: str) -> str:
    return told[told.index("| queries") : told.index("| variant |")]
