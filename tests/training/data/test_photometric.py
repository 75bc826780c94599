"""Photometric augmentation changes how a scene looks and not where things are."""

from collections.abc import Callable

import numpy as np
import pytest

from training.data import photometric
from training.data.images import Pixels

Augmentation = Callable[[Pixels, np.random.Generator], Pixels]


def scene() -> Pixels:
    """Grass below, sky above, with a little texture."""
    image = np.empty((96, 128, 3), np.uint8)
    image[:48], image[48:] = (150, 190, 240), (60, 120, 40)
    image += np.random.default_rng(0).integers(0, 8, image.shape, np.uint8)
    return image


@pytest.mark.parametrize("augment", [photometric.mild, photometric.strong])
def test_augmentation_is_repeatable_and_keeps_the_size(augment: Augmentation) -> None:
    for seed in range(20):
        first, second = (augment(scene(), np.random.default_rng(seed)) for _ in range(2))
        assert first.dtype == np.uint8
        assert first.shape == scene().shape
        np.testing.assert_array_equal(first, second)


def test_a_surface_takes_another_colour_and_keeps_its_texture_and_its_neighbours() -> None:
    """Snow on the grass: what was alike stays alike, and the sky stays as it was."""
    before = scene().astype(np.float32) / np.float32(255)
    moved = []
    for seed in range(40):
        after = photometric._repainted(before, np.random.default_rng(seed))
        change = np.abs(after - before).mean(axis=(1, 2))
        sky, grass = change[:48].mean(), change[48:].mean()
        moved.append((sky, grass))
        assert after[48:].std(axis=(0, 1)).max() < 0.1
    # The colour is a random pixel's from the lower two thirds: mostly grass, sometimes sky, never both alike.
    assert sum(grass > 3 * sky for sky, grass in moved) > 15
    assert max(grass for _, grass in moved) > 0.3
