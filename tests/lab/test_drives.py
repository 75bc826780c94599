"""The orders in which a walk is driven."""

from itertools import groupby, pairwise

import numpy as np

from lab.drives import GOING, STANDING, stop_and_go


def test_a_drive_with_stops_passes_all_images_in_order_and_stands_at_some() -> None:
    order = stop_and_go(200, np.random.default_rng(5))
    assert list(dict.fromkeys(order)) == list(range(200))
    assert order == sorted(order)
    lengths = [len(list(same)) for _, same in groupby(order)]
    stops = [index for index, length in enumerate(lengths) if length > 1]
    assert all(STANDING[0] <= lengths[index] < STANDING[1] for index in stops)
    assert all(GOING[0] <= later - earlier < GOING[1] for earlier, later in pairwise(stops))
    assert len(stops) > 200 / GOING[1]
