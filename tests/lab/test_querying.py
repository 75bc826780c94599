"""A run enrols, queries, remembers, and goes on where it stopped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.evaluation.querying import Answer, fingerprint, query_all, ranked_by
from schemas.errors import NothingStatic, SetupError, Unavailable
from schemas.records import Position
from tests.lab.fakes import FakeRetriever, walk


def near(a: int, b: int) -> float:
    return 1 - abs(a - b) / 10


def test_answers_are_database_numbers(tmp_path: Path) -> None:
    answers = query_all(walk(tmp_path), FakeRetriever(near), depth=5)
    assert answers.ranked[:30, 0].tolist() == list(range(30))
    assert answers.ranked.shape == (40, 5)
    assert answers.before is not None
    assert np.array_equal(answers.before, answers.ranked[:, ::-1])
    assert answers.claimed is not None
    assert answers.claimed[:30].all()
    assert not answers.claimed[35:].any()
    assert answers.timing_ms["total"].tolist() == [1.5] * 40


class Stopped(Exception):
    pass


def test_a_stopped_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    dataset = walk(tmp_path / "set")

    def stop(what: str, done: int, total: int) -> None:
        if what == "querying" and done == 17:
            raise Stopped

    first, second, third = FakeRetriever(near), FakeRetriever(near), FakeRetriever(near)
    with pytest.raises(Stopped):
        query_all(dataset, first, journals=tmp_path / "runs", progress=stop)
    [journal] = (tmp_path / "runs").iterdir()
    with journal.open("a") as lines:
        lines.write('{"query": 17, "vie')  # the power went while this was being written
    resumed = query_all(dataset, second, journals=tmp_path / "runs")
    assert len(first.queries) + len(second.queries) == len(dataset.queries)
    whole = query_all(dataset, FakeRetriever(near))
    assert np.array_equal(resumed.ranked, whole.ranked)
    query_all(dataset, third, journals=tmp_path / "runs")
    assert third.queries == []
    assert third.enrolled == {}


def test_what_changes_an_answer_starts_a_new_journal(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    same = fingerprint(dataset, "r", 0, 20)
    assert fingerprint(walk(tmp_path), "r", 0, 20) == same
    others = [
        fingerprint(dataset, "r2", 0, 20),
        fingerprint(dataset, "r", 1, 20),
        fingerprint(dataset, "r", 0, 10),
        fingerprint(replace(dataset, truth="+-2"), "r", 0, 20),
    ]
    dataset.queries[0].write_bytes(b"another image")
    others.append(fingerprint(dataset, "r", 0, 20))
    dataset.queries[0].write_bytes(b"another i(age")  # as many bytes
    others.append(fingerprint(dataset, "r", 0, 20))
    moved = np.zeros((len(dataset.database), 2))
    others.append(fingerprint(replace(dataset, database_positions=moved), "r", 0, 20))
    assert len({same, *others}) == 8


def test_a_drive_knows_only_its_past(tmp_path: Path) -> None:
    whole = walk(tmp_path)
    frames = whole.database
    allowed = np.maximum(np.arange(30) - 4, 0)
    drive = replace(whole, queries=frames, allowed=allowed, positives=tuple(np.zeros(0, np.int64) for _ in frames))
    answers = query_all(drive, FakeRetriever(near))
    best = answers.ranked[:, 0]
    assert best[:5].tolist() == [-1] * 4 + [-1]
    assert best[5:].tolist() == list(range(25))


def test_images_that_are_refused_are_counted(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    cars = tmp_path / "d" / "0cars.jpg"
    cars.write_bytes(b"")
    answers = query_all(replace(dataset, database=(cars, *dataset.database[1:])), FakeRetriever(near))
    assert answers.refused == {"nothing-static": 1}
    assert answers.ranked[0, 0] == 1


@pytest.mark.parametrize("stopped_at", [3, 40])
def test_refusals_are_counted_once_although_a_run_goes_on(tmp_path: Path, stopped_at: int) -> None:
    dataset = walk(tmp_path / "set")
    cars = [tmp_path / "set" / folder / "0cars.jpg" for folder in "dq"]
    for path in cars:
        path.write_bytes(b"")

    class Picky(FakeRetriever):
        def query(self, image: Path, top: int) -> Answer:
            if "cars" in image.name:
                raise NothingStatic("nothing but cars")
            return super().query(image, top)

    def stop(what: str, done: int, total: int) -> None:
        if what == "querying" and done == stopped_at:
            raise Stopped

    both = replace(dataset, database=(cars[0], *dataset.database[1:]), queries=(cars[1], *dataset.queries[1:]))
    with pytest.raises(Stopped):
        query_all(both, Picky(near), journals=tmp_path / "runs", progress=stop)
    for _ in range(2):
        assert query_all(both, Picky(near), journals=tmp_path / "runs").refused == {"nothing-static": 2}


def test_a_service_that_is_down_does_not_count_as_wrong_answers(tmp_path: Path) -> None:
    class Down(FakeRetriever):
        def query(self, image: Path, top: int) -> Answer:
            raise Unavailable("stopping", 5)

    with pytest.raises(Unavailable):
        query_all(walk(tmp_path / "set"), Down(near), journals=tmp_path / "runs")
    assert [p.read_text() for p in (tmp_path / "runs").iterdir()] == []


def test_the_same_file_twice_stands_for_both(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    twice = replace(dataset, database=(*dataset.database[:29], dataset.database[5]))
    answers = query_all(twice, FakeRetriever(near))
    assert set(answers.ranked[5, :2].tolist()) == {5, 29}


def test_a_map_that_is_not_empty_is_refused(tmp_path: Path) -> None:
    class Occupied(FakeRetriever):
        def query(self, image: Path, top: int) -> Answer:
            return Answer(("somebody-elses-view",))

    with pytest.raises(SetupError, match="empty map"):
        query_all(walk(tmp_path), Occupied(near))


def test_positions_are_enrolled_with_the_images(tmp_path: Path) -> None:
    seen = []

    class Watching(FakeRetriever):
        def enroll(self, image: Path, position: Position) -> str:
            seen.append((int(image.stem), position.x, position.y))
            return super().enroll(image, position)

    dataset = walk(tmp_path)
    places = np.column_stack([np.arange(30.0), np.zeros(30)])
    query_all(replace(dataset, database_positions=places), Watching(near))
    assert all(x == number and y == 0 for number, x, y in seen)
    assert [number for number, _, _ in seen] != sorted(number for number, _, _ in seen)  # ties favour no walk


def test_a_baselines_distances_respect_what_a_query_may_know(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    drive = replace(
        dataset, queries=dataset.database, allowed=np.arange(30), positives=tuple([np.zeros(0, np.int64)] * 30)
    )
    distances = np.abs(np.subtract.outer(np.arange(30.0), np.arange(30.0))).astype(np.float32)
    answers = ranked_by(distances, drive, "perfect")
    assert answers.ranked[:, 0].tolist() == [-1, *range(29)]
    assert answers.confidence is not None
    assert answers.confidence[0] < answers.confidence[1:].min()
