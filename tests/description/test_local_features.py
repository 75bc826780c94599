"""Keypoints: where they are, how they are stored, and that the same image gives the same ones."""

import numpy as np
import pytest

from schemas.image import Bytes2D
from worker.description.local_features import local_features, reduce, root_descriptors
from worker.method import verification


def textured(height: int = 240, width: int = 320) -> Bytes2D:
    coarse = np.random.default_rng(4).integers(0, 256, (height // 8, width // 8, 3), dtype=np.uint8)
    return np.kron(coarse, np.ones((8, 8, 1), np.uint8))


def test_the_same_image_gives_the_same_keypoints_strongest_first() -> None:
    first, second = local_features(textured(), 100), local_features(textured(), 100)
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.descriptors, second.descriptors)
    assert len(first) == 100
    fewer = local_features(textured(), 50)
    assert {tuple(p) for p in fewer.positions.tolist()} <= {tuple(p) for p in first.positions.tolist()}


def test_positions_are_fractions_of_the_longer_side() -> None:
    found = local_features(textured(), 200)
    assert found.positions[:, 0].max() <= 1
    assert 0.5 < found.positions[:, 1].max() <= 0.75
    tall = local_features(np.ascontiguousarray(textured().transpose(1, 0, 2)), 200)
    assert tall.positions[:, 0].max() <= 0.75


@pytest.mark.parametrize("shape", [(200, 300, 3), (32, 32, 3), (1, 40, 3)])
def test_an_image_without_structure_has_none(shape: tuple[int, ...]) -> None:
    found = local_features(np.full(shape, 127, np.uint8), 100)
    assert len(found) == 0
    assert found.descriptors.shape == (0, 48)
    assert found.descriptors.dtype == np.int8


def test_equalising_finds_other_keypoints_and_a_larger_size_finds_more() -> None:
    dark = (textured() // 8).astype(np.uint8)
    plain, equalised = local_features(dark, 300, equalised=False), local_features(dark, 300)
    assert min(len(plain), len(equalised)) > 100
    assert not np.array_equal(plain.positions, equalised.positions)
    assert len(local_features(textured(), 2000, 640)) > 1.5 * len(local_features(textured(), 2000))


def test_a_third_of_the_light_finds_the_same_keypoints_where_nothing_is_equalised() -> None:
    bright, dark = textured(), (textured() // 3).astype(np.uint8)
    [found] = verification.verify(
        local_features(dark, 300, equalised=False), [local_features(bright, 300, equalised=False)]
    )
    assert found.inliers > 200


def test_descriptors_are_unit_length_in_bytes() -> None:
    drawn = np.random.default_rng(0).uniform(0, 0.2, (5, 128)).astype(np.float32)
    length = np.linalg.norm(reduce(drawn).astype(np.float32), axis=1)
    np.testing.assert_allclose(length, 127, atol=3)


def test_a_part_of_an_image_lies_where_it_was_cut() -> None:
    whole = textured(320, 480)
    part = np.ascontiguousarray(whole[40:280, 80:400])
    [found] = verification.verify(local_features(part, 300), [local_features(whole, 300)])
    assert found.inliers >= 20
    assert found.transform is not None
    # x in fractions of 320 becomes (320 x + 80) / 480; y likewise with 40.
    expected = [[2 / 3, 0, 1 / 6], [0, 2 / 3, 1 / 12]]
    np.testing.assert_allclose(found.transform, expected, atol=0.02)


def test_upright_keypoints_match_where_the_camera_is_held_straight_and_not_where_it_is_turned() -> None:
    whole = textured(320, 480)
    part = np.ascontiguousarray(whole[40:280, 80:400])
    turned = np.ascontiguousarray(np.rot90(part))

    def matches(query: Bytes2D, upright: bool) -> int:
        ours, theirs = (reduce(root_descriptors(pixels, 300, upright=upright)[1]) for pixels in (query, whole))
        return len(verification.match(ours, [theirs])[0])

    assert matches(part, upright=True) > 30
    assert matches(turned, upright=True) < matches(turned, upright=False) / 2


def test_an_upright_keypoint_is_described_once() -> None:
    positions, descriptors = root_descriptors(textured(), 200, upright=True)
    assert len(np.unique(positions, axis=0)) > 0.9 * len(positions)
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1, atol=1e-4)
