"""Furniture is drawn where it was put, the same each time, and the place behind it stays."""

import numpy as np
import pytest

from scenes import scene
from scenes.refurnishing import FURNITURE, Furniture, Piece, furnished

HALL = scene("corridor refurnished").sized(320, 240)


@pytest.mark.parametrize("kind", FURNITURE)
def test_a_piece_is_seen_where_its_mask_says_and_nowhere_else(kind: Furniture) -> None:
    bare, _ = furnished(HALL, [])
    full, [mask] = furnished(HALL, [Piece(kind, 0.3, 3.0, 5)])

    difference = np.abs(bare.astype(int) - full).max(axis=2)
    changed = difference > 40
    assert 0.01 < mask.mean() < 0.4
    assert difference[mask > 0].mean() > 5 * difference[mask == 0].mean()
    near = np.argwhere(mask)
    changed[near[:, 0].min() - 3 : near[:, 0].max() + 4, near[:, 1].min() - 3 : near[:, 1].max() + 4] = False
    assert changed.mean() < 0.01


def test_a_piece_that_is_moved_looks_the_same_elsewhere() -> None:
    piece = Piece("cupboard", -0.7, 4.0, 1)
    [there], [here] = furnished(HALL, [piece])[1], furnished(HALL, [piece.moved(across=1.2)])[1]

    assert np.argwhere(here)[:, 1].mean() - np.argwhere(there)[:, 1].mean() > 40
    assert 0.6 < here.sum() / there.sum() < 1.6


def test_the_nearer_piece_hides_the_farther() -> None:
    both = furnished(HALL, [Piece("cupboard", 0.0, 5.0, 1), Piece("cupboard", 0.0, 3.0, 2)])[1]
    [alone] = furnished(HALL, [Piece("cupboard", 0.0, 5.0, 1)])[1]

    assert both[0].sum() < alone.sum()


def test_the_same_furniture_gives_the_same_image() -> None:
    pieces = [Piece("plant", 0.4, 3.0, 3), Piece("chair", -0.5, 3.5, 4)]

    assert np.array_equal(furnished(HALL, pieces)[0], furnished(HALL, pieces)[0])
