"""Pictures of no place: equal arguments, equal pictures; of one kind, and yet never the same."""

import numpy as np
import pytest

from scenes.placeless import KINDS, SIZE, placeless


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_has_many_images(kind: str) -> None:
    one, same, other = placeless(kind, 1), placeless(kind, 1), placeless(kind, 2)

    assert one.shape == (*SIZE, 3)
    assert one.dtype == np.uint8
    assert np.array_equal(one, same)
    assert np.abs(one.astype(int) - other).mean() > 3


def test_kinds_with_one_seed_differ() -> None:
    taken = [placeless(kind, 1) for kind in KINDS]
    assert len({one.tobytes() for one in taken}) == len(KINDS)
