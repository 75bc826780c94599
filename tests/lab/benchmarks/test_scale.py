"""Sets among views of other sites: what is found there, and what a larger map would give."""

from pathlib import Path

import numpy as np
import pytest

from lab.benchmarks import scale
from lab.scale.forecast import recall_forecast
from lab.scale.sources import originals
from tests.sample_images import drawn, encoded

PLACES = 4


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sites of four places each, seen twice, and a walk elsewhere."""
    root = tmp_path_factory.mktemp("data")
    for site in range(2):
        folder = root / "places" / f"site{site}"
        rows = ["query_folder,query_file,database_folder,database_file"]
        for place in range(PLACES):
            pixels = drawn(96, 72, 10 * site + place)
            for moment, shown in (("query", pixels // 10 * 9), ("database", pixels)):
                (folder / moment).mkdir(parents=True, exist_ok=True)
                (folder / moment / f"{place}.jpg").write_bytes(encoded(shown))
            rows.append(f"query,{place}.jpg,database,{place}.jpg")
        (folder / "ground_truth.csv").write_text("\n".join(rows))
    walk = root / "unlabelled" / "indoor" / "walk"
    walk.mkdir(parents=True)
    for step in range(3):
        (walk / f"{step}.jpg").write_bytes(encoded(drawn(96, 72, 100 + step)))
    return root


def _run(action: str, data: Path, tmp_path: Path, *more: str) -> None:
    cache = str(tmp_path / "cache.sqlite")
    scale.main([action, "--data", str(data), "--cache", cache, "--encoder", "color", "--scenes", "2", *more])


def test_a_set_is_found_among_views_of_other_sites(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _run("describe", data, tmp_path)
    _run("measure", data, tmp_path, "--sizes", "10", "30", "--forecast", "1000")
    told = capsys.readouterr().out
    assert "site0 query -> database: 4 queries, 4 views of its own" in told
    # 19 files and their mirror images and crops, and 2 drawings; the 8 files of the set's own site, varied or not, are
    # no distractors, so a map has at most 4 + 59 - 24 views.
    assert "59 views" in told
    assert "      30   1.000" in told, "a right view is among the ten nearest of thirty"
    assert "(forecast)" in told


def test_describing_goes_on_where_it_was_stopped(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _run("describe", data, tmp_path, "--views", "25")
    _run("describe", data, tmp_path, "--views", "30")
    _run("measure", data, tmp_path, "--sizes", "10", "--forecast")
    assert "30 views" in capsys.readouterr().out


def test_a_cache_of_another_recipe_is_not_added_to(data: Path, tmp_path: Path) -> None:
    _run("describe", data, tmp_path, "--views", "1")
    with pytest.raises(ValueError, match="name another file"):
        scale.main(["describe", "--data", str(data), "--cache", str(tmp_path / "cache.sqlite"), "--views", "2"])


def test_sites_keep_their_own_views_out_of_the_distractors(data: Path) -> None:
    assert {source.site for source in originals(data)} == {"site0", "site1", "unlabelled/indoor/walk"}


def test_the_forecast_agrees_with_maps_of_that_size() -> None:
    """Shares of nearer distractors drawn from one distribution: 2,000 views foretell what 20,000 give."""
    random = np.random.default_rng(0)
    shares = np.exp(random.uniform(np.log(1e-5), np.log(1e-1), (2, 4000)))
    small, large = random.binomial(2_000, shares), random.binomial(20_000, shares)
    fixed = np.zeros((2, 4000), np.int64)
    foretold = recall_forecast(fixed, small, 2_000, 20_000, (10, 50))
    seen = [(large < count).any(axis=0).mean() for count in (10, 50)]
    assert np.allclose(foretold, seen, atol=0.03)


def test_a_view_behind_too_many_of_its_own_set_is_never_forecast() -> None:
    nothing = np.zeros((1, 1), np.int64)
    assert recall_forecast(nothing + 10, nothing, 100, 1000, (10,)) == 0.0
