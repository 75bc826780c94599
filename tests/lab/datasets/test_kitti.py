"""KITTI's odometry layout: ground plane, gap, halves."""

from pathlib import Path

import numpy as np
import pytest

from lab.datasets import kitti
from lab.datasets.dataset import UnexpectedLayout
from lab.metrics.chance import suspicions
from tests.lab.datasets.drawn import image


def drive(root: Path, z: list[float], height: float = 0.0, below: str = "") -> Path:
    """A sequence 00 that goes along z; y is height."""
    lines = [f"1 0 0 0 0 1 0 {height * i} 0 0 1 {p}" for i, p in enumerate(z)]
    (root / below / "poses").mkdir(parents=True)
    (root / below / "poses" / "00.txt").write_text("\n".join(lines) + "\n")
    for i in range(len(z)):
        image(root / below / "sequences" / "00" / "image_2" / f"{i:06d}.png", i)
    return root


def test_online_loop_closure_by_hand(tmp_path: Path) -> None:
    # Out 0, 10, 20, 30 and back 20, 10, 0 with a gap of 3 frames.
    [found] = kitti.read(drive(tmp_path, [0, 10, 20, 30, 20, 10, 0]), gap=3, radius_m=5)
    assert found.allowed is not None
    assert found.allowed.tolist() == [0, 0, 0, 1, 2, 3, 4]
    assert [p.tolist() for p in found.positives] == [[], [], [], [], [], [1], [0]]
    assert found.database[0].name == "000000.png"


def test_halves_in_time(tmp_path: Path) -> None:
    [found] = kitti.read(drive(tmp_path, [0, 10, 20, 20, 10]), protocol="halves", radius_m=5)
    assert [p.tolist() for p in found.positives] == [[], [], [1]]
    assert found.allowed is None


def test_every_other_frame_keeps_the_gap_in_time(tmp_path: Path) -> None:
    [found] = kitti.read(drive(tmp_path, [0, 0, 0, 0, 0, 0]), every=2, gap=3)
    # Frames 0, 2, 4: frame 4 may know frames up to 1, so frame 0 only.
    assert found.allowed is not None
    assert found.allowed.tolist() == [0, 0, 1]


def test_height_is_not_the_ground_plane(tmp_path: Path) -> None:
    # Climbing 10 m a frame without moving in x and z: the same place, as seen from above.
    drive(tmp_path, [0, 0, 0, 0], height=10)
    places = kitti.ground_plane(tmp_path / "poses" / "00.txt")
    assert places.tolist() == [[0, 0]] * 4
    [found] = kitti.read(tmp_path, protocol="halves", radius_m=5)
    assert [p.tolist() for p in found.positives] == [[0, 1], [0, 1]]


def test_a_straight_street_is_suspected_of_using_height(tmp_path: Path) -> None:
    [found] = kitti.read(drive(tmp_path, [100.0 * i for i in range(4)]))
    assert any("height" in s for s in suspicions(found.judged(), found.query_positions))


def test_the_folder_dataset_is_found(tmp_path: Path) -> None:
    assert len(kitti.read(drive(tmp_path, [0, 1], below="dataset"))[0].queries) == 2


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda root: (root / "poses" / "00.txt").unlink(), "no such file"),
        (lambda root: (root / "poses" / "00.txt").write_text("1 2 3\n"), "line 1 has 3 numbers"),
        (lambda root: (root / "poses" / "00.txt").write_text("a " * 12), "could not convert"),
        (lambda root: (root / "poses" / "00.txt").write_text(""), "empty"),
        (lambda root: (root / "sequences/00/image_2/000000.png").unlink(), "1 images .* but 2 poses"),
    ],
)
def test_what_was_expected_is_said(tmp_path: Path, spoil: object, says: str) -> None:
    drive(tmp_path, [0, 1])
    assert callable(spoil)
    spoil(tmp_path)
    with pytest.raises(UnexpectedLayout, match=says) as refusal:
        kitti.read(tmp_path)
    assert "ROOT/poses/00.txt" in str(refusal.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"1 0 0 nan 0 1 0 0 0 0 1 0\n" * 2, "line 1 has a number that is not finite"),
        (b"\xff\xfe\x00", "this is no text"),
    ],
)
def test_poses_that_are_no_poses(tmp_path: Path, content: bytes, says: str) -> None:
    drive(tmp_path, [0.0, 100.0])
    (tmp_path / "poses" / "00.txt").write_bytes(content)
    with pytest.raises(UnexpectedLayout, match=says):
        kitti.read(tmp_path)


def test_gap_zero_lets_a_frame_find_itself_and_is_the_users_choice(tmp_path: Path) -> None:
    [found] = kitti.read(drive(tmp_path, [0.0, 100.0]), gap=0)
    assert found.allowed is not None
    assert np.array_equal(found.allowed, [1, 2])
