"""A running service is measured through its own HTTP interface."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from app import measured
from app.client import Revisit
from app.main import create_app
from schemas.settings import Settings
from tests.pictures import drawn, encoded
from worker.bootstrap import build
from worker.datasets.dataset import Dataset
from worker.evaluate import run


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    house = build(Settings(data=tmp_path / "data", encoder="color", threads=1))
    with TestClient(create_app(house)) as running:
        monkeypatch.setattr(measured, "Revisit", lambda url: Revisit(url, transport=running._transport))
        yield running


def pictures(folder: Path, kind: str, count: int) -> tuple[Path, ...]:
    folder.mkdir()
    paths = tuple(folder / f"{i}.{kind}" for i in range(count))
    for i, path in enumerate(paths):
        path.write_bytes(encoded(drawn(160, 120, i), kind))
    return paths


def test_the_same_pictures_in_another_format_are_known_again(service: TestClient, tmp_path: Path) -> None:
    database, queries = pictures(tmp_path / "d", "png", 8), list(pictures(tmp_path / "q", "jpeg", 8))
    queries[7].write_bytes(b"no picture")
    where = np.column_stack([np.arange(8.0), np.zeros(8)])
    positives = tuple(np.array([i], np.int64) for i in range(8))
    dataset = Dataset("formats", database, tuple(queries), positives, "the same picture", database_positions=where)

    outcome = run(dataset, [measured.contender("http://test", "default")], examples=0)

    after, before = outcome.evaluation.methods
    assert (after.method, before.method) == ("default", "default, histograms alone")
    assert after.recall[0].value == 7 / 8
    assert after.refused == {"not-a-picture": 1}
    assert "encode" in after.timing_ms
    assert service.get("/maps").json() == {"maps": []}
