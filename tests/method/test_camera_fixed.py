"""What a camera carries along is found in views of many places, and left out of queries that show it."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.description import Appearance, ContextGraph, Description, Int8s, LocalFeatures
from worker.method.byte_vectors import quantise
from worker.method.camera_fixed import LEAST_VIEWS, camera_fixed, share_left_out, without_fixed
from worker.method.dense_cells import halve
from worker.method.unit_length import unit

ROWS, COLUMNS, DIMENSIONS = 4, 6, 32
BONNET = np.zeros((ROWS, COLUMNS), np.bool_)
BONNET[3] = True
BONNET[2, 2:4] = True


NO_GRAPH = ContextGraph(np.zeros(0, np.int16), *(np.zeros(shape, np.float32) for shape in ((0, 2), (0, 1), 0)))


def places(count: int, seed: int = 0, mask: np.ndarray = BONNET, alike: float = 0.0) -> Int8s:
    """Cells of `count` places that show the same where the mask says so, and share `alike` of the rest."""
    rng = np.random.default_rng(seed)
    own = unit(rng.normal(size=(count, ROWS, COLUMNS, DIMENSIONS)).astype(np.float32))
    common = unit(np.random.default_rng(99).normal(size=(ROWS, COLUMNS, DIMENSIONS)).astype(np.float32))
    share = np.where(mask, 0.95, alike)[..., None].astype(np.float32)
    return quantise(unit(np.sqrt(share) * common + np.sqrt(1 - share) * own))


def described(cells: Int8s) -> Description:
    """A query with a keypoint in the middle of each cell, row by row, of an image that is three by two."""
    extent = (1.0, 2 / 3)
    x, y = np.meshgrid((np.arange(COLUMNS) + 0.5) / COLUMNS, (np.arange(ROWS) + 0.5) / ROWS * extent[1])
    positions = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32)
    return Description(
        vectors={},
        appearance=Appearance(quantise(halve(cells)), NO_GRAPH, extent),
        cells=cells,
        keypoints=LocalFeatures(positions, np.ones((len(positions), 2), np.int8)),
        label_shares=np.ones(1, np.float32),
        static_share=1.0,
        descriptor_count=1,
    )


def test_what_is_the_same_in_views_of_many_places_is_fixed_to_the_camera() -> None:
    found = camera_fixed(places(24))
    assert found is not None
    assert (found.sure == BONNET).all()
    assert len(found.keypoints) == 0


@pytest.mark.parametrize(
    "cells",
    [
        places(LEAST_VIEWS - 1),
        places(24, mask=np.zeros_like(BONNET)),
        places(24, alike=0.6),
        places(24, mask=np.ones_like(BONNET)),
        places(24)[:, :0, :0],
    ],
    ids=[
        "few views",
        "nothing is fixed",
        "a corridor that looks alike everywhere",
        "one photo again and again",
        "paper",
    ],
)
def test_nothing_is_said_to_be_fixed_where_that_cannot_be_told(cells: Int8s) -> None:
    assert camera_fixed(cells) is None


def test_a_query_by_the_same_camera_is_left_with_what_the_place_shows() -> None:
    fixed = camera_fixed(places(24))
    query = described(places(1, seed=7)[0])

    shown = without_fixed(query, [None, fixed])

    assert (shown.cells.any(axis=-1) == ~BONNET).all()
    assert (shown.cells[~BONNET] == query.cells[~BONNET]).all()
    assert (shown.appearance.coarse == quantise(halve(shown.cells))).all()
    assert shown.keypoints is not None
    assert query.keypoints is not None
    assert np.array_equal(shown.keypoints.positions, query.keypoints.positions[~BONNET.ravel()])
    assert share_left_out(query, shown) == pytest.approx(BONNET.mean())


def test_a_query_by_another_camera_stays_whole() -> None:
    query = described(places(1, seed=7, mask=np.zeros_like(BONNET))[0])
    assert without_fixed(query, [camera_fixed(places(24))]) is query
    assert share_left_out(query, query) == 0


def test_a_query_by_another_recipe_stays_whole() -> None:
    query = described(places(1, seed=7)[0][:, :, :8])
    assert without_fixed(query, [camera_fixed(places(24))]) is query


def test_a_query_without_keypoints_loses_cells_alone() -> None:
    query = replace(described(places(1, seed=7)[0]), keypoints=None)
    shown = without_fixed(query, [camera_fixed(places(24))])
    assert shown.keypoints is None
    assert not shown.cells[BONNET].any()


def test_views_are_compared_without_it_at_both_resolutions() -> None:
    fixed = camera_fixed(places(24))
    assert fixed is not None
    view, by_another_camera = places(1, seed=7)[0], places(1, seed=8, mask=np.zeros_like(BONNET))[0]

    assert (fixed.cleared(view).any(axis=-1) == ~BONNET).all()
    assert (fixed.cleared(by_another_camera) == by_another_camera).all()
    halved = BONNET.reshape(2, 2, 3, 2).all(axis=(1, 3))
    assert halved.any()
    assert (fixed.cleared(quantise(halve(view))).any(axis=-1) == ~halved).all()
    other_recipe = view[:, :, :8]
    assert fixed.cleared(other_recipe) is other_recipe


def letters(count: int, seed: int = 0) -> list[LocalFeatures]:
    """Keypoints of `count` views: each keeps seven of ten on letters, not quite in place, and twenty of its own."""
    rng = np.random.default_rng(seed)
    written = np.random.default_rng(5)
    at = np.stack([np.linspace(0.02, 0.3, 10), np.full(10, 0.05)], axis=1)
    looks = unit(written.normal(size=(10, DIMENSIONS)).astype(np.float32))
    views = []
    for _ in range(count):
        kept = rng.permutation(10)[:7]
        positions = np.concatenate([at[kept] + rng.normal(0, 0.001, (7, 2)), rng.random((20, 2)) * (1, 2 / 3)])
        own = unit(rng.normal(size=(20, DIMENSIONS)).astype(np.float32))
        noisy = unit(looks[kept] + 0.03 * rng.normal(size=(7, DIMENSIONS)).astype(np.float32))
        views.append(LocalFeatures(positions.astype(np.float32), quantise(np.concatenate([noisy, own]))))
    return views


def test_letters_are_found_by_their_keypoints_and_take_the_cells_below_with_them() -> None:
    below = np.zeros_like(BONNET)
    below[0, :2] = True
    rng = np.random.default_rng(1)
    cells = unit(places(25, mask=below, alike=0.0).astype(np.float32))
    cells[:, below] = unit(cells[:, below] + 0.7 * unit(rng.normal(size=(25, 2, DIMENSIONS)).astype(np.float32)))
    shown = quantise(cells)

    found = camera_fixed(shown[:24], letters(24))

    assert found is not None
    assert not found.sure.any()
    assert len(found.keypoints) == 10
    query = replace(described(shown[24]), keypoints=letters(25)[24])
    left = without_fixed(query, [found])
    assert left.keypoints is not None
    assert len(left.keypoints) == 20 - int((letters(25)[24].positions[7:] * (6, 6) < (2, 1)).all(axis=1).sum())
    assert (~left.cells.any(axis=-1) == below).all()
    assert (
        camera_fixed(shown[:24], [LocalFeatures(one.positions[7:], one.descriptors[7:]) for one in letters(24)]) is None
    )
