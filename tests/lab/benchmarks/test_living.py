"""The benchmark of a large map measures what it says: filters that let pass what they are named for, in turns."""

import os
from pathlib import Path

import pytest

from lab.benchmarks.filling import RUNS
from lab.benchmarks.living import PARTS, filters_of, in_turns, measured, opened
from schemas.settings import Settings

VIEWS = 200


def test_work_is_done_in_turns() -> None:
    done: list[str] = []
    times = in_turns({"a": lambda: done.append("a"), "b": lambda: done.append("b")}, 2)
    assert done == ["a", "b"] * 3  # the first of them warms up
    assert {name: len(found) for name, found in times.items()} == {"a": 2, "b": 2}


def test_each_filter_lets_pass_what_it_is_named_for(tmp_path: Path) -> None:
    passing = {
        "no filter": VIEWS,
        "near, half of the map": VIEWS // 2,
        "near, 1 in 100": VIEWS // 100,
        "after, half of the map": VIEWS // 2,
        "place, one view": 1,
        "metadata.run, 1 in 10": VIEWS // RUNS,
        "exclude_last=20": VIEWS - 20,
        "where: a range of x, half": VIEWS // 2,
        "where: metadata or a prefix": round(VIEWS * 0.64),
    }
    with opened(Settings(data=tmp_path, encoder="color", threads=1), VIEWS, 1, 4) as bench:
        for name, filters in filters_of(VIEWS).items():
            found = bench.runtime.services.searcher.search(
                {"default": filters}, bench.runtime.default_recipe.description, bench.descriptions[0], top=5
            )
            assert found.searched == pytest.approx(passing[name], abs=5), name


def test_every_figure_is_measured(tmp_path: Path) -> None:
    rows = measured(Settings(data=tmp_path, encoder="color", threads=1), PARTS, 60, 2, 4, 500)
    told = {row.what: row.figure for row in rows}
    for what in (
        "search, place, one view",
        "as the next one of a drive",
        "longest query while it changes over",
        "snapshot",
        "queries while the report is made",
    ):
        assert told[what]
    assert float(told["longest query while it changes over"]) > 0
    assert not list((tmp_path / "snapshots").glob("*")), "snapshots are removed"
    assert os.listdir(tmp_path / "pictures")
