"""The faults of section 5 show on a drawn drive, without any picture."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.kitti_protocols import main, protocols, row


def drive() -> np.ndarray:
    """Round a block of 400 m once and a half, on flat ground: the second half revisits part of the first."""
    along = np.linspace(0, 1.5, 1200) * 4 % 4
    corner, part = along.astype(int), along % 1
    x = np.choose(corner, [part, np.ones_like(part), 1 - part, np.zeros_like(part)]) * 400
    z = np.choose(corner, [np.zeros_like(part), part, np.ones_like(part), 1 - part]) * 400
    poses = np.zeros((1200, 12))
    poses[:, 3], poses[:, 11] = x, z
    poses[:, 7] = 2 * np.sin(along)
    return poses


def test_height_for_depth_turns_luck_into_a_result() -> None:
    poses = drive()
    right, height, offset, neighbours = (row(p, poses) for p in protocols(len(poses)))
    # Under the right truth a perfect ranking finds every answerable query and no other.
    assert right[1] == pytest.approx([right[0]] * 4)
    assert right[2][3] < right[1][3]
    # With height for depth nearly all queries have "answers", luck does better and perfection worse than it should.
    assert height[0] > right[0]
    assert height[2][3] > 2 * right[2][3]
    assert height[1][0] < height[0]
    assert offset[1][0] < height[1][0]
    # Every other frame as database: the neighbour frame is always right.
    assert neighbours[1][0] == 1


def test_the_command_prints_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "00.txt", drive())
    main([str(tmp_path / "00.txt")])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 4
    assert len({line.count("|") for line in lines}) == 1
