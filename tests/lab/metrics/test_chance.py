"""A random and a constant retriever are found out; so are the faults that make a good one look random."""

import numpy as np
import pytest

from lab.metrics.chance import TOO_FEW, looks_like_chance, suspicions
from lab.metrics.recall import Indices, Truth

SIZE = 120
WALK = Truth.of([list(range(max(0, i - 2), min(SIZE, i + 3))) for i in range(SIZE)], SIZE)


def good(noise: float = 5.0, seed: int = 0) -> Indices:
    """A retriever that knows its place up to some frames."""
    rng = np.random.default_rng(seed)
    places = np.arange(SIZE)
    distance = np.abs(places[:, None] - places[None, :]) + noise * rng.standard_normal((SIZE, SIZE))
    return np.argsort(distance, axis=1)[:, :20]


def test_a_retriever_that_knows_something_passes() -> None:
    luck = looks_like_chance(good(), WALK, np.random.default_rng(1))
    assert not luck.at_chance
    assert luck.causes == ()


@pytest.mark.parametrize("seed", range(5))
def test_a_random_retriever_is_found_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranked = np.array([rng.permutation(SIZE)[:20] for _ in range(SIZE)])
    luck = looks_like_chance(ranked, WALK, np.random.default_rng(seed))
    assert luck.at_chance
    assert luck.causes


def test_a_constant_retriever_is_found_out_and_named() -> None:
    ranked = np.tile(np.arange(20), (SIZE, 1))
    luck = looks_like_chance(ranked, WALK, np.random.default_rng(0))
    assert luck.at_chance
    assert "same first answer" in luck.causes[0]


def test_a_constant_retriever_is_found_out_where_its_answers_are_right_for_most() -> None:
    # The trap of a test against uniform chance: one busy square that most queries show.
    truth = Truth.of([[7] if i % 10 else [50] for i in range(SIZE)], SIZE)
    ranked = np.tile(np.array([7, 1, 2, 3, 4]), (SIZE, 1))
    assert looks_like_chance(ranked, truth, np.random.default_rng(0)).at_chance


def test_a_retriever_without_answers_is_at_chance() -> None:
    assert looks_like_chance(np.full((SIZE, 5), -1), WALK, np.random.default_rng(0)).at_chance


def test_truth_offset_from_the_images_is_named() -> None:
    # What the paper's newest KITTI code does: the pose of frame i for query i of the second half.
    luck = looks_like_chance(np.roll(good(1.0), 30, axis=0), WALK, np.random.default_rng(0))
    assert luck.at_chance
    assert "offset" in luck.causes[0]
    assert "30 places" in luck.causes[0]


def test_truth_in_reverse_order_is_named() -> None:
    luck = looks_like_chance(good(1.0)[::-1].copy(), WALK, np.random.default_rng(0))
    assert luck.at_chance
    assert "reverse" in luck.causes[0]


@pytest.mark.parametrize("places", [[0], [0, 1, 2, 3], [7] * 20, [7] * 11 + [8]], ids=str)
def test_queries_too_few_or_of_too_few_places_are_said_to_tell_nothing(places: list[int]) -> None:
    truth = Truth.of([[place] for place in places], 100)
    perfect = np.array([[place, 50, 51] for place in places])
    luck = looks_like_chance(perfect, truth, np.random.default_rng(0))
    assert luck.at_chance
    assert luck.causes == (TOO_FEW.format(len(places)),)


def test_few_queries_of_as_many_places_may_tell_enough() -> None:
    truth = Truth.of([[place] for place in range(7)], 100)
    perfect, wrong = (np.arange(7)[:, None] + shift for shift in (0, 1))
    assert not looks_like_chance(perfect, truth, np.random.default_rng(0)).at_chance
    luck = looks_like_chance(wrong, truth, np.random.default_rng(0))
    assert luck.at_chance
    assert "file order" in luck.causes[0]


def test_no_answerable_query_is_said() -> None:
    luck = looks_like_chance(np.zeros((2, 1), np.int64), Truth.of([[], []], 3), np.random.default_rng(0))
    assert luck.at_chance
    assert "no query has a right answer" in luck.causes[0]


def test_height_for_depth_is_suspected() -> None:
    # KITTI 00: x spans 563.5 m, y (height) 25.5 m, z 496.2 m.
    rng = np.random.default_rng(0)
    drive = rng.uniform(0, 1, (500, 2))
    assert any("height" in s for s in suspicions(WALK, drive * [563.5, 25.5]))
    assert suspicions(WALK, drive * [563.5, 496.2]) == ()


def test_a_database_of_nothing_but_right_answers_is_suspected() -> None:
    # The paper's Pittsburgh subset: a few queries, and as database the union of their positives.
    truth = Truth.of([list(range(5 * i, 5 * i + 5)) for i in range(3)], 15)
    assert any("without distractors" in s for s in suspicions(truth))
