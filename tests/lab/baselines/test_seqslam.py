"""A walk is recognised by its sequence where its single images say little."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.baselines.seqslam import Matched, SeqSlam, enhanced, matched, sequence_scores


def walk(folder: Path, count: int, noise: float, seed: int) -> list[Path]:
    """Frames of one path: drawn textures, the same for all walks, under as much noise of each walk's own."""
    folder.mkdir(parents=True)
    path, own = np.random.default_rng(0), np.random.default_rng(seed)
    images = []
    for i in range(count):
        frame = path.normal(size=(32, 64)) + noise * own.normal(size=(32, 64))
        images.append(folder / f"{i:03}.png")
        assert cv2.imwrite(str(images[-1]), np.clip(frame * 30 + 128, 0, 255).astype(np.uint8))
    return images


def test_a_sequence_is_known_again_where_single_images_are_not(tmp_path: Path) -> None:
    database, queries = walk(tmp_path / "d", 60, 4, seed=1), walk(tmp_path / "q", 60, 4, seed=2)
    ticks: list[int] = []

    sequences = SeqSlam().rank(database, queries, lambda: ticks.append(1))
    single = SeqSlam(length=1).rank(database, queries, lambda: None)

    assert sequences.dtype == np.float32
    assert len(ticks) == 120
    rightly = np.abs(sequences.argmin(axis=1) - np.arange(60)) <= 1
    alone = np.abs(single.argmin(axis=1) - np.arange(60)) <= 1
    assert rightly[10:].mean() > 0.95
    assert alone.mean() < 0.8
    assert np.array_equal(sequences, SeqSlam().rank(database, queries, lambda: None))


def test_local_contrast_hides_a_place_that_lasts_for_many_images(tmp_path: Path) -> None:
    """A walk so slow that fifteen images show one place: told from its surroundings, it is like them."""
    own = np.random.default_rng(1)
    places = np.random.default_rng(0).normal(size=(4, 32, 64))
    database: list[Path] = []
    queries: list[Path] = []
    for i in range(60):
        for name, images in (("d", database), ("q", queries)):
            frame = places[i // 15] + own.normal(size=(32, 64))
            images.append(tmp_path / f"{name}{i:02}.png")
            assert cv2.imwrite(str(images[-1]), np.clip(frame * 30 + 128, 0, 255).astype(np.uint8))

    def rightly(seqslam: SeqSlam) -> float:
        found = seqslam.rank(database, queries, lambda: None).argmin(axis=1)
        return float(np.mean(found // 15 == np.arange(60) // 15))

    published, plain = SeqSlam(), SeqSlam(local_contrast=False)
    assert rightly(plain) > 0.95
    assert rightly(published) < rightly(plain)
    assert plain.name != published.name


def test_an_answer_depends_on_what_came_before_alone(tmp_path: Path) -> None:
    """It is asked as the drive goes on: no image of the future takes part in an order."""
    database, queries = walk(tmp_path / "d", 30, 2, seed=1), walk(tmp_path / "q", 30, 2, seed=2)
    whole, half = (SeqSlam().rank(database, some, lambda: None) for some in (queries, queries[:15]))
    assert np.array_equal(np.argsort(whole[:15], axis=1), np.argsort(half, axis=1))


def test_lines_by_hand() -> None:
    # The walk is driven at the same speed: zeros along the diagonal that begins at database image 1.
    differences = np.ones((3, 5), np.float32)
    for i in range(3):
        differences[i, i + 1] = 0
    differences[0, 0] = 0
    scores = sequence_scores(differences, length=3, speeds=np.array([1.0]))
    # Lines that would begin before the first database image stay at it, where the first query differs by nothing.
    assert scores[2].tolist() == pytest.approx([2 / 3, 2 / 3, 2 / 3, 0, 1])
    assert scores[0].tolist() == [0, 0, 1, 1, 1]


def test_a_walk_at_another_speed_needs_a_line_of_that_speed() -> None:
    differences = np.ones((10, 20), np.float32)
    for back in range(10):
        differences[9 - back, 11 - round(1.2 * back)] = 0
    same, other = (sequence_scores(differences, speeds=np.array([speed])) for speed in (1.0, 1.2))
    assert other[9, 11] == 0
    assert same[9].min() == pytest.approx(0.5), "half of it lies near a line of the wrong speed"


def test_contrast_is_local_by_hand() -> None:
    # A window of 2 has the image itself and one on either side: 1, 3, 5 around 3 is its own mean.
    found = enhanced(np.array([[1, 3, 5]], np.float32), window=2)
    # At the ends two remain: (1 - 2) / 1 and (5 - 4) / 1; then the least is taken off.
    assert found.tolist() == [pytest.approx([0, 1, 2])]


def test_uniqueness_by_hand() -> None:
    scores = np.array([[4, 1, 2, 8, 2.5], [3, 3, 3, 3, 3]], np.float32)
    found = matched(scores, window=2)
    assert isinstance(found, Matched)
    assert found.image.tolist() == [1, 0]
    # Outside the window of image 1 lie 8 and 2.5.
    assert found.quotient.tolist() == pytest.approx([1 / 2.5, 1])
    assert matched(scores[:, :2], window=10).quotient.tolist() == [1, 1], "nothing outside, nothing unique"
