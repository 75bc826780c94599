"""Two images of one place agree on an epipolar geometry; two of different places do not."""

import numpy as np
import pytest

from lab.baselines.two_views import Keypoints, clear_matches, fundamental, inliers
from schemas.description import Floats


def through_two_cameras(count: int, wrong: int) -> tuple[Floats, Floats]:
    """Positions of points in depth, float32 (count + wrong, 2), seen from two places; the last `wrong` at random."""
    random = np.random.default_rng(3)
    x, y, z = random.uniform(-1, 1, count), random.uniform(-1, 1, count), random.uniform(2, 6, count)
    ours = np.column_stack([x / z, y / z]) / 2 + 0.5
    theirs = np.column_stack([(x + 0.8) / (z + 0.3), (y + 0.1) / (z + 0.3)]) / 2 + 0.5
    noise = random.uniform(0, 1, (2, wrong, 2))
    return np.concatenate([ours, noise[0]]).astype(np.float32), np.concatenate([theirs, noise[1]]).astype(np.float32)


def test_a_fundamental_matrix_is_the_same_at_every_call_and_finds_points_in_depth() -> None:
    source, target = through_two_cameras(60, 20)
    first = fundamental(source, target)
    assert all((fundamental(source, target) == first).all() for _ in range(5))
    assert first[:60].mean() > 0.9
    assert first[60:].mean() < 0.4


def test_matches_on_one_spot_have_no_fundamental_matrix() -> None:
    """OpenCV fails on an assertion instead of saying so."""
    points = np.full((30, 2), 0.5, np.float32)
    assert fundamental(points, points).shape == (30,)


@pytest.mark.parametrize("count", [0, 7])
def test_too_few_matches_have_no_fundamental_matrix(count: int) -> None:
    points = np.zeros((count, 2), np.float32)
    assert not fundamental(points, points).any()


def test_clear_matches_by_hand() -> None:
    def at(*degrees: float) -> Floats:
        angles = np.radians(np.array(degrees))
        return np.column_stack([np.cos(angles), np.sin(angles)]).astype(np.float32)

    # 0 is nearest to 2 and clearly so; 30 lies between 25 and 36: clear at .9 alone; 88's nearest belongs to 90.
    query, image = at(0, 30, 90, 88), at(2, 25, 36, 91)
    assert clear_matches(query, image).tolist() == [[0, 0], [2, 3]]
    assert clear_matches(query, image, ratio=0.9).tolist() == [[0, 0], [1, 1], [2, 3]]
    assert clear_matches(query, image[:1]).shape == (0, 2), "one descriptor has no second nearest"
    assert clear_matches(query[:0], image).shape == (0, 2)


def test_descriptors_that_repeat_are_no_clear_matches() -> None:
    """A row of equal windows: the nearest is as near as the next."""
    window = np.tile(np.array([[1.0, 0.0]], np.float32), (5, 1))
    assert clear_matches(window, window).shape == (0, 2)


def test_inliers_count_what_agrees_and_not_what_matches_by_chance() -> None:
    ours, theirs = through_two_cameras(60, 0)
    random = np.random.default_rng(0)
    descriptors = random.normal(size=(60, 32)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    order = random.permutation(60)
    same = inliers(Keypoints(ours, descriptors), Keypoints(theirs[order], descriptors[order]))
    scattered = random.uniform(0, 1, (60, 2)).astype(np.float32)
    other = inliers(Keypoints(ours, descriptors), Keypoints(scattered, descriptors))
    assert same > 54
    assert other < same / 2
