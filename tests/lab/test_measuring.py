"""Figures stand beside chance and ceiling; pretenders are found out through the whole path."""

from pathlib import Path

import numpy as np
import pytest

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
