"""The filter of drives: probabilities, motion, and what it makes of walks and of jumbled images."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from worker.method.drive import (
    FARTHEST,
    KNOWN,
    OTHERS,
    TEMPERED,
    Drive,
    Single,
    follow,
    kernel,
    predict,
    spread,
    supposed,
)

VIEWS = 100
DOUBTFUL = 0.35


def image(*at: int, sure: float = DOUBTFUL, none: float = 0.2) -> Single:
    """An image whose first candidate is `at[0]` with the probability `sure`; the others share the rest."""
    seqs = np.array(sorted(at), np.int64)
    rest = (1 - sure - none) / max(len(at) - 1, 1)
    probabilities = np.where(seqs == at[0], sure if len(at) > 1 else 1 - none, rest)
    return Single(seqs, seqs, probabilities, VIEWS)


def after(*images: Single) -> tuple[Drive, "np.ndarray[tuple[int, ...], np.dtype[np.float64]]"]:
    drive, together = Drive(), np.zeros(0)
    for one in images:
        drive, together = follow(drive, one)
    return drive, together


def test_the_first_image_says_what_it_says_on_its_own() -> None:
    one = image(40, 7, 80)
    drive, together = after(one)
    assert together == pytest.approx(one.probabilities)
    assert drive.images == 1


def test_doubtful_images_of_a_walk_add_up() -> None:
    walk = [image(10 + i, (37 * i) % VIEWS, (61 * i + 5) % VIEWS) for i in range(1, 9)]
    drive, together = after(*walk)
    assert together[list(walk[-1].seqs).index(18)] > 0.9
    assert drive.coherence > 0.9


@pytest.mark.parametrize("step", [0, -1, 5])
def test_it_may_stand_go_back_or_be_fast(step: int) -> None:
    walk = [image(50 + step * i, (37 * i + 3) % VIEWS, (61 * i + 8) % VIEWS) for i in range(9)]
    _, together = after(*walk)
    assert together[list(walk[-1].seqs).index(50 + step * 8)] > DOUBTFUL + 0.1


@pytest.mark.parametrize("seed", range(5))
def test_jumbled_images_are_answered_much_as_single_ones(seed: int) -> None:
    drawn = np.random.default_rng(seed)
    drive, surest = Drive(), []
    for _ in range(40):
        drive, together = follow(drive, image(*drawn.choice(VIEWS, 3, replace=False).tolist()))
        surest.append(float(together.max()))
    assert np.median(surest) == pytest.approx(DOUBTFUL, abs=0.1)
    assert max(surest) < 0.9


def test_a_robot_that_is_carried_away_is_found_again() -> None:
    before = [image(10 + i, (37 * i + 60) % VIEWS) for i in range(6)]
    moved = [image(80 + i, (29 * i + 20) % VIEWS) for i in range(6)]
    _, together = after(*before, *moved)
    assert together[list(moved[-1].seqs).index(85)] > DOUBTFUL + 0.3


@pytest.mark.parametrize("step", [1, -2, 4])
def test_the_pace_of_a_drive_is_learnt(step: int) -> None:
    walk = [image(50 + step * i, (37 * i + 3) % VIEWS, (61 * i + 8) % VIEWS) for i in range(10)]
    drive, _ = after(*walk)
    expected, _, _ = predict(drive, np.arange(VIEWS), VIEWS)
    assert int(expected.argmax()) == 50 + step * 10
    assert expected[50 + step * 10] > 5 * expected[50 + step * 8]


def test_what_looks_like_one_view_for_long_is_no_stretch_of_the_map() -> None:
    walk = [image(10 + i, (37 * i + 60) % VIEWS, sure=0.7) for i in range(12)]
    _, ahead = after(*walk, *(image(22 + i, (37 * i) % VIEWS, sure=0.7, none=0.25) for i in range(8)))
    _, stuck = after(*walk, *(image(40, (37 * i) % VIEWS, sure=0.7, none=0.25) for i in range(8)))
    assert ahead.max() > 0.95
    assert stuck.max() < 0.9


def test_off_the_map_it_becomes_nowhere() -> None:
    walk = [image(10 + i, sure=0.6, none=0.1) for i in range(5)]
    off = [image((i * 41) % VIEWS, (i * 17 + 9) % VIEWS, sure=0.02, none=0.96) for i in range(8)]
    _, together = after(*walk, *off)
    assert together.sum() < 0.1


SINGLES = st.builds(
    lambda seqs, weights, none, searched: Single(
        np.array(sorted(seqs), np.int64),
        np.array(sorted(seqs), np.int64),
        (1 - none) * np.array(weights[: len(seqs)]) / sum(weights[: len(seqs)]),
        searched,
    ),
    st.sets(st.integers(0, 300), min_size=1, max_size=8),
    st.lists(st.floats(1e-9, 1), min_size=8, max_size=8),
    st.floats(0, 1),
    st.integers(1, 300),
)


@given(st.lists(SINGLES, min_size=1, max_size=8))
def test_probabilities_are_probabilities(images: list[Single]) -> None:
    drive = Drive()
    for one in images:
        drive, together = follow(drive, one)
        assert (together >= 0).all()
        assert together.sum() <= 1 + 1e-9
        assert drive.walked.sum() + drive.elsewhere + drive.nowhere == pytest.approx(1)
        assert min(drive.elsewhere, drive.nowhere, drive.coherence) >= 0
        assert (np.diff(drive.seqs) > 0).all()


@given(SINGLES, st.integers(0, 300))
def test_moving_changes_no_total(one: Single, where: int) -> None:
    drive, _ = after(one)
    arrived, elsewhere, nowhere = predict(drive, np.array([where]), VIEWS)
    assert arrived.sum() + elsewhere + nowhere == pytest.approx(1)
    assert min(float(arrived.min()), elsewhere, nowhere) >= -1e-12


def test_moves_sum_to_one_and_end() -> None:
    steps = np.arange(-2 * FARTHEST, 2 * FARTHEST + 1)
    assert kernel(supposed(), steps).sum() == pytest.approx(1)
    assert kernel(supposed(), np.array([FARTHEST + 1, -FARTHEST - 1])).sum() == 0


def test_the_probability_of_a_place_is_shared_by_its_views() -> None:
    first = np.array([True, False, True, False])
    shared = spread(np.array([0.9, 0.8, 0.5, 0.2]), first, 0.6, 0.05)
    sure = 1.5**TEMPERED / (1 + 1.5**TEMPERED)
    assert shared[first].sum() == pytest.approx(sure)
    assert shared.sum() == pytest.approx(sure + (1 - sure) * OTHERS)
    assert spread(np.array([0.9]), np.array([True]), 1.0, 0.05).sum() < 1
    assert shared[0] > shared[2]
    assert shared[1] > shared[3] > 0


def test_nothing_is_known_at_first() -> None:
    assert Drive().nowhere == 1 - KNOWN
    assert len(Drive().seqs) == 0
