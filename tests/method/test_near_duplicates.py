"""Views whose descriptions hardly differ."""

import numpy as np

from worker.method import near_duplicates
from worker.method.near_duplicates import alike, similarity


def test_each_row_knows_its_nearest_later_rows() -> None:
    rng = np.random.default_rng(0)
    apart = rng.normal(0, 10, (3 * near_duplicates.BLOCK // 2, 8)).astype(np.float32)
    apart[700] = apart[3] + 0.02
    apart[701] = apart[3] + 0.01
    found = alike(apart, 0.1, 20)
    assert {i: later for i, later in enumerate(found) if later} == {3: [701, 700], 700: [701]}
    assert alike(apart, 0.1, 1)[3] == [701]


def test_cells_are_compared_where_both_are_static() -> None:
    cells = np.random.default_rng(1).integers(-9, 9, (3, 4, 16), np.int8)
    half = cells.copy()
    half[:2] = 0
    assert abs(similarity(cells, cells) - 1) < 1e-6
    assert abs(similarity(cells, half) - 1) < 1e-6
    assert abs(similarity(cells, -cells) + 1) < 1e-6
    assert similarity(cells, np.zeros_like(cells)) == 0.0
    assert similarity(cells, cells[:2]) == 0.0
