"""Figures stand beside chance and ceiling; pretenders are found out through the whole path."""

from pathlib import Path

import numpy as np
import pytest

from lab.datasets.dataset import Dataset
from lab.evaluation.measuring import frame, measure
from lab.evaluation.querying import query_all
from tests.lab.fakes import FakeRetriever, walk


def near(a: int, b: int) -> float:
    return 1 - abs(a - b) / 10


def test_a_good_retriever(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    whole = frame(dataset)
    assert (whole.queries, whole.answerable, whole.ceiling_of_all) == (40, 30, 0.75)
    assert whole.chance[0] == pytest.approx((28 * 3 + 2 * 2) / 30 / 30)
    after, before = measure(dataset, query_all(dataset, FakeRetriever(near)))
    assert after.recall[0].value == 1
    assert after.recall_of_all[0].value == 0.75
    assert not after.luck.at_chance
    assert before.method == "fake, histograms alone"
    assert before.recall[0].value == 0
    assert after.gain is not None
    assert after.gain[0].value == 1
    assert after.known_place is not None
    assert before.known_place is None
    assert after.known_place.best_f1 == 1  # the nearest unknown place is .1 less sure
    assert after.calibrated is not None
    assert after.timing_ms["total"] == (1.5, 1.5)


def test_the_last_quarter_is_rejected(tmp_path: Path) -> None:
    dataset = walk(tmp_path)
    [known, _] = measure(dataset, query_all(dataset, FakeRetriever(lambda a, b: float(a == b))))
    assert known.known_place is not None
    assert known.known_place.rejected == 1
    assert known.known_place.wrong_claims == 0
    assert known.known_place.recall_at_full_precision == 1


@pytest.mark.parametrize("pretender", ["random", "constant", "without content"])
def test_pretenders_are_found_out(tmp_path: Path, pretender: str) -> None:
    """A retriever that ignores the image must not pass, whatever its figures look like."""
    rng = np.random.default_rng(5)
    ways = {
        "random": lambda a, b: float(rng.random()),
        "constant": lambda a, b: float(-b),
        "without content": lambda a, b: 0.5,
    }
    dataset = walk(tmp_path)
    for figures in measure(dataset, query_all(dataset, FakeRetriever(ways[pretender]))):
        assert figures.luck.at_chance, f"{figures.method} of the {pretender} retriever passed as knowing places"
        assert figures.luck.causes


def test_queries_that_are_in_the_database_themselves_are_told_of(tmp_path: Path) -> None:
    for name, content in (("d/a", b"one"), ("d/b", b"two"), ("q/a", b"one"), ("q/b", b"six")):
        (tmp_path / f"{name}.jpg").parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.jpg").write_bytes(content)
    database, queries = (tuple(tmp_path / d / f"{i}.jpg" for i in "ab") for d in "dq")
    right = (np.array([0]), np.array([1]))
    told = frame(Dataset("leak", database, queries, right, "same name")).suspicions[0]
    assert told.startswith("1 of 2 queries are in the database themselves, byte for byte (first: a.jpg)")
    apart = frame(Dataset("no leak", database, queries[1:], right[1:], "same name"))
    assert not any("themselves" in one for one in apart.suspicions)


def test_a_frame_that_may_be_answered_with_itself_is_told_of(tmp_path: Path) -> None:
    files = tuple(tmp_path / f"{i}.jpg" for i in range(3))
    none = (np.zeros(0, np.int64),) * 3
    past = Dataset("past", files, files, none, "none", allowed=np.array([0, 1, 2]))
    assert not any("themselves" in one for one in frame(past).suspicions)
    itself = Dataset("itself", files, files, none, "none", allowed=np.array([1, 2, 2]))
    assert frame(itself).suspicions[0].startswith("2 of 3 queries are in the database themselves")
