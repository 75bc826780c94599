"""Decisions measured on the service itself: encoder without weights, real SQLite file, maps enrolled like a user's."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab import decide
from lab.datasets.dataset import Dataset
from lab.datasets.layout import with_attributes
from lab.datasets.protocols import Query, whole
from lab.decide import measure
from lab.evaluation.deciding import Decided, Options, as_decisions, decide_all, is_right, trials
from lab.evaluation.decision_plots import PLOTS
from lab.evaluation.decision_tables import POOLED, as_json, as_markdown, rows
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from lab.evaluation.service import map_of_its_own
from lab.metrics.decisions import Kind
from schemas.description import PixelField
from schemas.image import Image
from schemas.settings import Settings
from tests.lab.test_service import street
from worker.encoders.color import ColorEncoder
from worker.method.calibration import Verdict
from worker.runtime import Runtime
from worker.service.query_options import QueryOptions


class CountingEncoder(ColorEncoder):
    """Remembers which images it encoded."""

    def __init__(self) -> None:
        super().__init__()
        self.encoded: list[str] = []

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        self.encoded += [image.digest for image in images]
        return super().encode(images)


ENCODER = CountingEncoder()


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runtime]:
    settings = Settings(data=tmp_path_factory.mktemp("never used"), encoder="color", threads=1)
    with runtime_for_measuring(settings, make_encoder=lambda *_: (ENCODER, None), make_scheduler=DescribeOnce) as one:
        yield one


def streets(root: Path, first: int, count: int) -> Dataset:
    """Separate places, two images of each."""
    places = range(first, first + count)
    database = tuple(
        street(root / "d" / f"p{p}_{i}.png", p, light) for p in places for i, light in ((1, 1.0), (2, 0.95))
    )
    queries = tuple(street(root / "q" / f"p{p}.png", p, 0.9) for p in places)
    positives = tuple(np.array([2 * i, 2 * i + 1], np.int64) for i in range(count))
    return Dataset(f"{root.name} q -> d", database, queries, positives, "the same street")


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> list[Dataset]:
    root = tmp_path_factory.mktemp("sets")
    return [streets(root / "north", 0, 6), streets(root / "south", 50, 4)]


OPTIONS = Options(stretches=2, sizes={1: 2}, others=1)


@pytest.fixture(scope="module")
def decided(runtime: Runtime, sets: list[Dataset]) -> list[Decided]:
    return measure(sets, sets, runtime, "default", OPTIONS)


def test_every_trial_is_decided_and_each_image_encoded_once(
    runtime: Runtime, sets: list[Dataset], decided: list[Decided]
) -> None:
    north = [d for d in decided if d.dataset.startswith("north")]
    everything = [d for d in north if d.protocol == "everything"]
    assert [d.kind for d in everything] == ["known"] * 6 + ["other-site"] * 4
    assert sum(d.right for d in everything) >= 5
    assert not any(d.right for d in north if d.kind != "known")
    assert sum(d.protocol == "half of the places" for d in north) == 2 * 6
    assert sum(d.protocol == "1 place" for d in north) == 2 * (6 + 1)
    assert all({"gap", "level", "breadth", "own"} <= set(d.features) for d in north)
    assert {d.image for d in everything} >= {"q/p0.png", "q/p50.png"}
    assert len(ENCODER.encoded) == len(set(ENCODER.encoded)) == 12 + 6 + 8 + 4
    assert runtime.store.maps.all() == []


def test_what_is_remembered_answers_as_what_is_described_anew(sets: list[Dataset], decided: list[Decided]) -> None:
    again = [d for d in decided if (d.dataset, d.protocol) == (sets[0].name, "everything")]
    settings = Settings(encoder="color", threads=1)
    with runtime_for_measuring(settings) as plain:
        anew = measure(sets[:1], sets, plain, "default", replace(OPTIONS, sizes={}))
    assert [d for d in anew if d.protocol == "everything"] == again


def test_maps_are_enrolled_with_names_or_positions(runtime: Runtime, sets: list[Dataset]) -> None:
    named = with_attributes(sets[0])
    placed = replace(named, places=None, database_positions=np.arange(24.0).reshape(12, 2))
    for dataset in (named, placed):
        with map_of_its_own(runtime, runtime.default_recipe, "default", dataset) as service:
            decide_all(replace(whole(dataset), queries=()), service)
            seqs = [c.seq for c in runtime.services.query.query(
                dataset.database[0].read_bytes(), service.map_name, options=QueryOptions(top=12)
            ).results.views]  # fmt: skip
            said = [view.attributes for view in runtime.store.views.at(seqs).values()]
        assert len(said) == 12
        if dataset is named:
            assert {a.place for a in said} == {f"place {i}" for i in range(1, 7)}
        else:
            assert {a.position.x for a in said} == set(np.arange(0.0, 24, 2))


def test_the_name_of_the_place_is_right_whichever_view_has_it(runtime: Runtime, sets: list[Dataset]) -> None:
    dataset = with_attributes(sets[0])
    with map_of_its_own(runtime, runtime.default_recipe, "default", dataset) as service:
        decide_all(replace(whole(dataset), queries=()), service)
        result = service.result(dataset.database[0], 5)
        first = result.results.views[0].view
    assert first.attributes.place == "place 1"
    images = {first.id: {0}}
    listed, other = np.array([1], np.int64), np.array([2], np.int64)

    def right(kind: Kind, answers: np.typing.NDArray[np.int64], of: Dataset) -> bool:
        return is_right(result, Query(dataset.database[0], kind, answers, "b"), images, of)

    assert right("known", listed, dataset)  # the other image of place 1
    assert not right("known", listed, sets[0])  # without names only the view counts
    assert right("known", np.array([0, 1], np.int64), sets[0])
    assert not right("known", other, dataset)
    assert not right("same-site", listed, dataset)


def test_a_query_that_cannot_be_read_has_no_answer(runtime: Runtime, sets: list[Dataset], tmp_path: Path) -> None:
    broken = tmp_path / "broken.png"
    broken.write_text("no image")
    query = Query(broken, "known", np.array([0], np.int64), "b")
    with map_of_its_own(runtime, runtime.default_recipe, "default", sets[0]) as service:
        [found], refused = decide_all(replace(whole(sets[0]), queries=(query,)), service)
    assert (found.status, found.confidence, found.right) == ("no_match", 0, False)
    assert refused == {"not-a-picture": 1}


def test_small_maps_get_a_draw_of_the_other_sites(sets: list[Dataset]) -> None:
    found = trials(sets[0], sets, OPTIONS)
    assert [t.protocol for t in found] == [
        "everything",
        "half of the places",
        "half of the places",
        "1 place",
        "1 place",
    ]
    count = [sum(q.kind == "other-site" for q in t.queries) for t in found]
    assert count == [4, 0, 0, 1, 1]
    with pytest.raises(ValueError, match="loop closure"):
        trials(replace(sets[0], allowed=np.full(6, 12)), sets, OPTIONS)


def one(dataset: str, kind: Kind, status: Verdict, confidence: float, right: bool = False, block: str = "b") -> Decided:
    return Decided(dataset, "everything", "q/1.jpg", kind, right, status, confidence, f"{dataset} {block}")


FEW = [
    one("a", "known", "matched", 0.9, True),
    one("a", "known", "matched", 0.8, block="c"),
    one("a", "other-site", "no_match", 0.1),
    one("b", "known", "ambiguous", 0.5, True),
    one("noisy", "known", "matched", 0.9),
]


def test_tables_have_a_row_a_set_and_one_for_all() -> None:
    found = rows(FEW, apart=["noisy"])
    assert [row.dataset for row in found] == ["a", "b", "noisy", POOLED]
    assert (found[-1].summary.precision.events, found[-1].summary.precision.queries) == (1, 2)
    lines = as_markdown(found).splitlines()
    assert lines[0] == "**everything**"
    assert lines[4].startswith("| a | 50.0 (0-100) of 2 | 50.0 (0-100) of 2 | 100.0 (")
    assert "| 0.0 (0.0-975.0; singly ≤ 975.0) |" in lines[4]  # 1 - .025 of 1,000
    assert all(line.count("|") == lines[2].count("|") for line in lines[2:])
    assert [row.dataset for row in rows(FEW)] == [row.dataset for row in found]
    assert rows(FEW)[-1].summary.precision.queries == 3


def test_json_has_no_number_that_is_none() -> None:
    text = json.dumps(as_json(rows(FEW), {"seed": "0"}), allow_nan=False)
    read = json.loads(text)
    assert read["rows"][0]["summary"]["precision"]["events"] == 1
    assert read["rows"][0]["summary"]["same_site_matched"]["low"] is None
    assert read["circumstances"] == {"seed": "0"}


@pytest.mark.parametrize("name", PLOTS)
def test_plots_mark_the_verdict(name: str) -> None:
    drawn = PLOTS[name](as_decisions(FEW).at_site)
    assert drawn.startswith(b"<?xml")
    assert (b">matched<" in drawn) == (name != "reliability")
    assert drawn == PLOTS[name](as_decisions(FEW).at_site)


def test_the_command_writes_tables_decisions_and_plots(
    sets: list[Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = sets[0].database[0].parent.parent.parent
    head = "query_folder,query_file,database_folder,database_file\n"
    for dataset in sets:
        pairs = [
            f"q,{q.name},d,{dataset.database[i].name}\n"
            for q, p in zip(dataset.queries, dataset.positives, strict=True)
            for i in p
        ]
        (dataset.database[0].parent.parent / "ground_truth.csv").write_text(head + "".join(pairs))
    monkeypatch.setenv("REVISIT_ENCODER", "color")
    told = ["pairs", "--root", str(root), "--out", str(tmp_path), "--sets", "north", "--stretches", "2"]
    assert decide.main([*told, "--sizes", "1x1,3"]) == 0
    table = (tmp_path / "decisions.md").read_text()
    assert table in capsys.readouterr().out + "\n"
    assert [line for line in table.splitlines() if line.startswith("**")] == [
        "**everything**", "**half of the places**", "**1 place**", "**3 places**"
    ]  # fmt: skip
    assert "south" not in table
    lines = (tmp_path / "decisions.jsonl").read_text().splitlines()
    assert len(lines) == (6 + 4) + 2 * 6 + (6 + 4) + (6 + 4)
    assert str(root) not in lines[0]
    assert json.loads((tmp_path / "decisions.json").read_text())["circumstances"]["seed"] == "0"
    assert len(list(tmp_path.glob("half-of-the-places-*.svg"))) == 3
    assert decide.main([*told, "--stretches", "3"]) == 2
    assert "stretches" in capsys.readouterr().err
