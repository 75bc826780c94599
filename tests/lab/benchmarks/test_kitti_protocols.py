"""The faults of section 5 show on a drawn drive, without any image."""

from pathlib import Path

import numpy as np
import pytest

from lab.benchmarks.kitti_protocols import main, protocols, row


def drive() -> np.ndarray:
    """Once round a block of 400 m, then along its first side again and through a new street inside, on flat ground."""
    part = np.linspace(0, 1, 150, endpoint=False)
    none, all_ = np.zeros_like(part), np.ones_like(part)
    x = 400 * np.concatenate([part, all_, 1 - part, none, part, part, 0.375 * all_, 0.375 * all_])
    z = 400 * np.concatenate([none, part, all_, 1 - part, none, none, part / 2, (1 + part) / 2])
    poses = np.zeros((len(x), 12))
    poses[:, 3], poses[:, 11] = x, z
    poses[:, 7] = np.sin(x / 100)
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


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "there is no such file"),
        ("1 0 0\n", "line 1 has 3 numbers, not 12"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 30, "30 poses are too short a drive: it takes 40"),
    ],
)
def test_poses_that_cannot_be_used_are_refused(
    content: str | None, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "00.txt").write_text(content)
    with pytest.raises(SystemExit):
        main([str(tmp_path / "00.txt")])
    message = capsys.readouterr().err
    assert "revisit benchmark kitti_protocols: error" in message
    assert said in message
