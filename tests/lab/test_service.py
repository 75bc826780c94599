"""The service itself, measured through its own use-cases: encoder without weights, real SQLite file."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.ablate import VARIANTS, ablate, as_markdown, recipe_of, remembering
from lab.benchmarks.ranking import measure, steps
from lab.datasets.dataset import Dataset
from lab.evaluate import run
from lab.evaluation.artist import KEPT, ServiceArtist
from lab.evaluation.in_process import contender, runtime_for_measuring
from lab.evaluation.querying import query_all
from lab.evaluation.service import ROOMS, ServiceRetriever, map_of_its_own, program
from schemas.errors import RevisitError
from schemas.records import Position
from schemas.settings import Settings
from worker.description.presets import general_vocabulary
from worker.description.vocabularies import Vocabulary
from worker.runtime import Runtime


def street(path: Path, seed: int, light: float) -> Path:
    """Coloured houses under some light; the same seed is the same place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    pixels = np.full((120, 160, 3), (200, 160, 110), np.uint8)
    for x in range(0, 160, 20):
        top = int(rng.integers(20, 90))
        cv2.rectangle(pixels, (x, top), (x + 19, 119), rng.integers(30, 255, 3).tolist(), -1)
    cv2.rectangle(pixels, (0, 105), (159, 119), (90, 90, 90), -1)
    assert cv2.imwrite(str(path), np.clip(pixels * light, 0, 255).astype(np.uint8))
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("streets")
    known = range(12)
    database = tuple(street(root / "d" / f"{i}.png", i, 1.0) for i in known)
    queries = tuple(street(root / "q" / f"{i}.png", i, 0.9) for i in range(15))
    positives = tuple(np.array([i] if i in known else [], np.int64) for i in range(15))
    position = np.column_stack([np.arange(12.0) * 10, np.zeros(12)])
    return Dataset("streets q -> d", database, queries, positives, "the same street", database_positions=position)


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runtime]:
    settings = Settings(
        data=tmp_path_factory.mktemp("never used"), images="s3://never/used", encoder="color", threads=1
    )
    with runtime_for_measuring(settings) as started:
        yield started


def test_answers_of_another_program_are_none_of_this_one(runtime: Runtime, walk: Dataset, tmp_path: Path) -> None:
    with map_of_its_own(runtime, runtime.default_recipe, "default", walk) as retriever:
        assert retriever.recipe.endswith(f" {program()}")
    rooms = tuple(tmp_path / room.name for room in ROOMS)
    for room, copy in zip(ROOMS, rooms, strict=True):
        shutil.copytree(room, copy, ignore=shutil.ignore_patterns("__pycache__"))
    assert program(rooms) == program()
    ranking = rooms[1] / "method" / "cascade.py"
    ranking.write_text(ranking.read_text() + "# another stage\n")
    program.cache_clear()
    assert program(rooms) != program()


def test_presets_know_streets_again_and_are_drawn(runtime: Runtime, walk: Dataset) -> None:
    outcome = run(walk, [contender(runtime, "default"), contender(runtime, "paper")])
    names = [m.method for m in outcome.evaluation.methods]
    assert names == ["default", "default, histograms alone", "paper", "paper, histograms alone"]
    default = outcome.evaluation.methods[0]
    assert default.recall[0].value > 0.8
    assert not default.luck.at_chance
    assert default.gain is not None
    assert default.calibrated is not None
    assert {"decode", "encode", "describe", "search", "rerank", "total"} <= set(default.timing_ms)
    captions = [shown.caption for e in outcome.examples for shown in e.images]
    assert any("segmentation by labels" in c for c in captions)
    assert any("what agrees" in c for c in captions)
    assert all(shown.data[:2] in (b"\x89P", b"\xff\xd8") for e in outcome.examples for shown in e.images)
    assert runtime.store.maps.all() == []


def test_answers_carry_evidence_for_calibration(runtime: Runtime, walk: Dataset) -> None:
    with contender(runtime, "default").open(walk) as retriever:
        answers = query_all(walk, retriever)
    assert {"gap", "level", "breadth", "own", "score", "rival_score", "wrong_score"} <= set(answers.features)
    assert len(answers.features["gap"]) == 15
    assert answers.features["level"].max() <= 0


def test_a_map_knows_what_wrong_answers_get_before_it_is_measured(runtime: Runtime, walk: Dataset) -> None:
    with contender(runtime, "default").open(walk) as retriever:
        assert isinstance(retriever, ServiceRetriever)
        for image in walk.database:
            retriever.enroll(image, Position())
        decision = retriever.result(walk.queries[0], top=1).decision
    assert decision.levels.compared > 10


def test_an_image_that_cannot_be_described_is_refused_with_its_reason(
    runtime: Runtime, walk: Dataset, tmp_path: Path
) -> None:
    (tmp_path / "text.png").write_text("no image")
    with contender(runtime, "default").open(walk) as retriever:
        with pytest.raises(RevisitError) as refusal:
            retriever.enroll(tmp_path / "text.png", Position())
        assert refusal.value.code == "not-a-picture"


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runtime]:
    """A runtime whose encoder encodes each image once."""
    settings = Settings(data=tmp_path_factory.mktemp("never used"), encoder="color", threads=1)
    with runtime_for_measuring(settings, make_encoder=remembering) as started:
        yield started


def test_variants_are_measured_with_an_encoder_that_encodes_once(walk: Dataset, once: Runtime) -> None:
    names = ("default", "channel detail alone", "histograms alone", "vocabulary of the set, without PCA")
    measured = ablate(walk, [v for v in VARIANTS if v.name in (*names, "paper, histograms alone")], once)
    assert {m.variant for m in measured} >= {"default", "channel detail alone", "histograms alone"}
    assert all(len(m.found) == 12 for m in measured)
    assert as_markdown(measured).count("|") > 10
    assert once.store.maps.all() == []


def test_a_variant_that_cannot_be_carried_out_is_left_out(
    walk: Dataset, once: Runtime, capsys: pytest.CaptureFixture[str]
) -> None:
    [many] = [v for v in VARIANTS if v.name == "vocabulary of the set, 256 words"]
    nothing = tuple(np.zeros(0, np.int64) for _ in walk.queries)
    few = replace(walk, database=walk.database[:1], positives=nothing, database_positions=None)
    assert ablate(few, [many], once) == []
    assert "left out vocabulary of the set, 256 words" in capsys.readouterr().err


def mirrored(runtime: Runtime) -> Vocabulary:
    """The general vocabulary with its words the other way round."""
    shipped = general_vocabulary(runtime.encoder, "default")
    return Vocabulary({n: replace(c, words=c.words[::-1].copy()) for n, c in shipped.channels.items()})


def test_a_variant_takes_another_vocabulary(walk: Dataset, once: Runtime, tmp_path: Path) -> None:
    other = mirrored(once)
    path = tmp_path / "other.safetensors"
    path.write_bytes(other.tensors)
    shipped = general_vocabulary(once.encoder, "default")
    assert recipe_of(VARIANTS[0], once, walk).description.vocabulary == shipped.digest
    recipe = recipe_of(replace(VARIANTS[0], vocabulary=path), once, walk)
    assert recipe.description.vocabulary == other.digest != shipped.digest
    assert once.store.vocabularies.get(other.digest) == other.tensors


def test_another_vocabulary_can_be_measured(runtime: Runtime, walk: Dataset) -> None:
    other = mirrored(runtime)
    with contender(runtime, "default", other).open(walk) as retriever:
        answers = query_all(walk, retriever)
        [owner] = runtime.store.maps.all()
    assert owner.description.vocabulary == other.digest
    assert (answers.ranked[:12, 0] == np.arange(12)).mean() > 0.8


def test_each_step_of_the_ranking_is_measured_on_the_service(runtime: Runtime, walk: Dataset) -> None:
    found = measure(walk, runtime, runtime.default_recipe, part=0.5)
    channels = runtime.default_recipe.description.parameters.channels
    assert list(found) == [step.name for step in steps(list(channels))]
    assert {len(right) for right in found.values()} == {6}
    assert np.mean(found["and keypoints verified"]) > 0.8
    assert runtime.store.maps.all() == []


def test_images_can_be_drawn_by_a_map(runtime: Runtime, walk: Dataset) -> None:
    with contender(runtime, "default").open(walk) as retriever:
        assert isinstance(retriever, ServiceRetriever)
        for image in walk.database[:3]:
            retriever.enroll(image, Position())
        shown = ServiceArtist(retriever).explain(walk.queries[0], walk.database[0])
    assert [s.wide for s in shown] == [False, False, True]


def test_no_map_of_one_answer_explains_what_the_whole_map_decided(
    runtime: Runtime, walk: Dataset, tmp_path: Path
) -> None:
    captions = []
    for _ in range(2):
        outcome = run(walk, [contender(runtime, "default")], journals=tmp_path, examples=1)
        captions.append([shown.caption for example in outcome.examples for shown in example.images])
    assert any("what agrees, and decided" in caption for caption in captions[0])
    assert not any("what agrees, and decided" in caption for caption in captions[1])
    assert KEPT in captions[1]
