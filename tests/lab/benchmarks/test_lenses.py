"""Queries by another camera: which images are redrawn, and that what is told of the camera is sent."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as PilImage

from lab.benchmarks.lenses import main, taken
from lab.datasets import pairs
from lab.datasets.dataset import Dataset
from scenes import scene
from schemas.image import Bytes2D
from tests.stories.photos import photo
from worker.service.query import QueryService

STEPS = (0.0, 2.0, 4.0, 6.0)


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """Steps along a street, and queries a bit aside of each."""
    rows = [["query_folder", "query_file", "database_folder", "database_file"]]
    for folder, aside in (("ref", 0.0), ("query", 0.3)):
        (tmp_path / "street" / folder).mkdir(parents=True)
        for number, ahead in enumerate(STEPS):
            seen = scene("mill lane").sized(320, 240).seen_from(dx=aside, ahead=ahead)
            (tmp_path / "street" / folder / f"{number}.jpg").write_bytes(photo(seen))
    rows += [["query", f"{number}.jpg", "ref", f"{number}.jpg"] for number in range(len(STEPS))]
    with (tmp_path / "street" / "ground_truth.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    return tmp_path


def pixels(path: Path) -> Bytes2D:
    with PilImage.open(path) as image:
        return np.asarray(image.convert("RGB"), np.uint8)


def test_the_narrower_cameras_images_are_the_middles(street: Path, tmp_path: Path) -> None:
    [dataset] = pairs.read(street)

    def sides(of: Dataset) -> list[set[tuple[int, ...]]]:
        return [{pixels(path).shape[1::-1] for path in paths} for paths in (of.database, of.queries)]

    narrower = taken(dataset, tmp_path / "narrow", "narrower", 1.6)
    assert sides(taken(dataset, tmp_path / "same", "the map's", 1.6)) == [{(320, 240)}, {(320, 240)}]
    assert sides(narrower) == [{(320, 240)}, {(200, 150)}]
    assert sides(taken(dataset, tmp_path / "wide", "wider", 1.6)) == [{(200, 150)}, {(320, 240)}]
    whole, middle = (pixels(one.queries[0]).astype(int) for one in (dataset, narrower))
    assert np.abs(whole[45:195, 60:260] - middle).mean() < 2


def test_a_turned_camera_sees_as_much_as_the_maps(street: Path, tmp_path: Path) -> None:
    [dataset] = pairs.read(street)
    level, leaning = (taken(dataset, tmp_path / f"{by}", "turned", 1.25, by) for by in (0.0, 90.0))

    assert {pixels(path).shape for path in (*level.database, *level.queries, *leaning.queries)} == {(192, 256, 3)}
    one, other = (pixels(set_.queries[0]).astype(int)[:, 32:224] for set_ in (level, leaning))
    assert np.abs(np.rot90(one) - other).mean() < 8


def test_each_zoom_is_sent_and_has_a_row(
    street: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sent: list[float] = []
    query = QueryService.query

    def noted(self: QueryService, *given: Any, **more: Any) -> Any:
        sent.append(more["options"].zoom)
        return query(self, *given, **more)

    monkeypatch.setattr(QueryService, "query", noted)
    monkeypatch.setenv("REVISIT_ENCODER", "color")
    assert main(["--root", str(street), "--zoom", "1.5", "--told", "1", "1.5", "--every", "1"]) == 0

    assert sorted(set(sent)) == [1.0, 1.5]
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| narrower")]
    assert [row[:3] for row in rows] == [["| narrower", "1.5", "1"], ["| narrower", "1.5", "1.5"]]
    assert all(row[3].endswith("of 4") for row in rows)
