"""The stages of enrolling and querying, measured on a small map with the encoder that needs no weights."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from app.cli.study import over_http
from lab.benchmarks import __main__ as benchmarks
from lab.benchmarks.filling import fill
from lab.benchmarks.stages import drawn
from schemas.records import Filters
from schemas.settings import Settings
from worker.runtime import build


def test_every_stage_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = tmp_path / "stages.json"
    given = [
        "--encoder",
        "color",
        "--views",
        "40",
        "--images",
        "6",
        "--repeats",
        "1",
        "--nearest",
        "5",
        "--threads",
        "1",
    ]
    assert benchmarks.main(["stages", *given, "--json", str(written)], over_http) == 0
    stages = [row["stage"] for row in json.loads(written.read_text())["rows"]]
    assert stages == [
        "encode and local features",
        "enroll, wait=false, all at once",
        "enroll, one after the other",
        "decode",
        "encode",
        "local features",
        "describe",
        "index from the database",
        "bare FAISS, semantic",
        "search, semantic",
        "bare FAISS, detail",
        "search, detail",
        "/query: search",
        "/query: rerank",
        "/query: verify",
        "/query: HTTP and the rest",
        "/query: all",
    ]
    assert capsys.readouterr().out.count("\n") == 2 + len(stages)


def test_calls_over_http_are_given_by_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["stages"]) == 2
    assert "./revisit benchmark stages" in capsys.readouterr().err


def test_an_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["speed"]) == 2
    assert "there are: stages, lseg, kitti_protocols, ranking" in capsys.readouterr().err


def test_filled_views_are_whole_and_found(tmp_path: Path) -> None:
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1))
    recipe, image = runtime.default_recipe, runtime.decode(drawn(1)[0])
    describer = runtime.describers.of(recipe.description)
    field = next(iter(runtime.encoder.encode([image])))
    description = describer.describe(image, field, describer.keypoints(image))
    runtime.store.maps.put("default", recipe, datetime.now(UTC))
    fill(runtime.settings.database_url, "default", recipe.description, [description], 30)
    results = runtime.services.searcher.search({"default": Filters()}, recipe.description, description, top=5)
    assert [scored.view.state for scored in results.views] == ["ready"] * 5
    assert results.searched == 30
