"""K random static cells, the same for the same image."""

import numpy as np
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from worker.method import sampling

DIGEST = "ab" * 32


@given(arrays(np.bool_, (6, 7)), st.integers(1, 60), st.integers(0, 5))
def test_draws_are_static_distinct_and_as_many_as_wanted(static: np.ndarray, count: int, seed: int) -> None:
    drawn = sampling.draw(static, count, sampling.generator(seed, DIGEST))

    assert static.ravel()[drawn].all()
    assert len(set(drawn.tolist())) == len(drawn) == min(count, int(static.sum()))


def test_the_same_image_and_seed_draw_the_same_cells_and_others_do_not() -> None:
    static = np.ones((20, 20), np.bool_)

    def draw(seed: int, digest: str) -> list[int]:
        return [int(cell) for cell in sampling.draw(static, 50, sampling.generator(seed, digest))]

    assert draw(0, DIGEST) == draw(0, DIGEST)
    assert draw(0, DIGEST) != draw(1, DIGEST)
    assert draw(0, DIGEST) != draw(0, "cd" * 32)


def test_without_a_number_every_static_cell_is_taken() -> None:
    static = np.array([[True, False], [True, True]])
    assert sampling.draw(static, None, sampling.generator(0, DIGEST)).tolist() == [0, 2, 3]


def test_every_cell_is_as_likely_as_any_other() -> None:
    static = np.ones((4, 4), np.bool_)
    counts = np.zeros(16)
    for image in range(2000):
        counts[sampling.draw(static, 4, sampling.generator(0, f"{image:064x}"))] += 1
    assert counts.min() > 400  # 500 expected, standard deviation 19
    assert counts.max() < 600
