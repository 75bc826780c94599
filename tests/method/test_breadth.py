"""Over how much of an image one view leads over another."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from worker.method.breadth import breadth

WEIGHTS = st.just(0.0) | st.floats(2**-20, 1, width=32)
CELLS = st.lists(WEIGHTS, min_size=6, max_size=6).map(lambda weights: np.array(weights, np.float32))
EXACT_FACTORS = st.integers(-7, 7).map(lambda power: 2.0**power)


def test_a_lead_everywhere_is_as_broad_as_the_image() -> None:
    assert breadth(np.full(16, 0.3, np.float32), np.full(16, 0.1, np.float32)) == pytest.approx(4)
    assert breadth(np.full(16, 0.3, np.float32), None) == pytest.approx(4)


def test_a_lead_in_one_spot_is_one_cell_broad() -> None:
    spot = np.zeros(16, np.float32)
    spot[3] = 0.5
    assert breadth(spot, np.zeros(16, np.float32)) == pytest.approx(1)


def test_a_lead_that_is_lost_elsewhere_is_narrow() -> None:
    mixed = np.array([0.4, -0.3, 0.4, -0.3], np.float32) + np.float32(0.5)
    assert breadth(mixed, np.full(4, 0.5, np.float32)) == pytest.approx(0.2 / np.sqrt(0.5))


def test_no_lead_has_no_breadth() -> None:
    assert breadth(np.zeros(4, np.float32), None) == 0
    assert breadth(np.full(4, 0.1, np.float32), np.full(4, 0.2, np.float32)) == 0


@given(CELLS, CELLS, EXACT_FACTORS)
def test_it_does_not_depend_on_the_level_of_weights(first: np.ndarray, other: np.ndarray, factor: float) -> None:
    found = breadth(first, other)
    assert 0 <= found <= np.sqrt(6) + 1e-9
    scaled = breadth((first * factor).astype(np.float32), (other * factor).astype(np.float32))
    assert scaled == pytest.approx(found)
