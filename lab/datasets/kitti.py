"""KITTI odometry: one drive, recognised in its second half or while it goes on."""

from pathlib import Path
from typing import Literal

import numpy as np

from lab.datasets.dataset import RADIUS_M, Dataset, UnexpectedLayout, images_in, within
from schemas.description import Doubles

EXPECTED = """\
  ROOT/sequences/00/image_2/000000.png ...   (left colour camera; or image_0, left grey)
  ROOT/poses/00.txt                          (12 numbers a line: a 3 x 4 pose, row by row; one line an image)
as unpacked from the KITTI odometry benchmark; ROOT/dataset/... is found as well. Only sequences 00 to 10 have
published poses."""

X, Z = 3, 11
"""Columns of the ground plane. Column 7 is y, which points down in the camera's frame: height. Truth from x and
height asks only whether the street is parallel, and made a random ranking look like a result (docs/evaluation.md)."""


def read(
    root: Path,
    *,
    sequence: str = "00",
    protocol: Literal["halves", "loop"] = "loop",
    radius_m: float = RADIUS_M,
    gap: int = 100,
    every: int = 1,
    camera: str = "image_2",
) -> list[Dataset]:
    """One sequence as one set.

    Parameters
    ----------
    root : Path
        The folder that holds ``sequences`` and ``poses``.
    sequence : str
    protocol : str
        ``loop``: online loop closure, frame i is looked for among frames 0 .. i - gap. ``halves``: the second half
        in time is looked for in the first. A shuffled split is not offered: with a neighbour 0.75 m away on either
        side, any descriptor reaches recall 1 and nothing is measured.
    radius_m : float
    gap : int
        Frames (of the whole sequence) that must lie between a query and the newest frame it may be answered with.
    every : int
        Use only every n-th frame; the gap is still counted in frames of the whole sequence.
    camera : str

    Returns
    -------
    list of one Dataset

    Raises
    ------
    UnexpectedLayout
        When a folder or file is missing, or images and poses differ in number.
    """
    if (root / "dataset" / "sequences").is_dir():
        root = root / "dataset"
    positions = ground_plane(root / "poses" / f"{sequence}.txt")
    images = images_in(root / "sequences" / sequence / camera, EXPECTED)
    if len(images) != len(positions):
        problem = f"{len(images)} images in sequences/{sequence}/{camera}, but {len(positions)} poses"
        raise UnexpectedLayout(root, problem, EXPECTED)
    frames, places = tuple(images[::every]), positions[::every]
    if protocol == "halves":
        half = len(frames) // 2
        return [
            Dataset(
                name=f"kitti {sequence} halves in time",
                database=frames[:half],
                queries=frames[half:],
                positives=tuple(within(places[:half], places[half:], radius_m)),
                truth=f"first half of the drive within {radius_m:g} m in the ground plane (x, z)",
                database_positions=places[:half],
                query_positions=places[half:],
            )
        ]
    # With every n-th frame, the newest frame allowed is the last whose number is at most i - gap.
    newest = (np.arange(len(frames)) * every - gap) // every + 1
    allowed = np.maximum(newest, 0).astype(np.int64)
    near = within(places, places, radius_m)
    return [
        Dataset(
            name=f"kitti {sequence} loop closure",
            database=frames,
            queries=frames,
            positives=tuple(p[p < n] for p, n in zip(near, allowed, strict=True)),
            truth=f"frames at least {gap} back, within {radius_m:g} m in the ground plane (x, z)",
            database_positions=places,
            query_positions=places,
            allowed=allowed,
        )
    ]


def ground_plane(path: Path) -> Doubles:
    """Positions in the ground plane from a file of poses, float64 (frames, 2), metres; raises as `read_poses`."""
    return read_poses(path)[:, [X, Z]]


def read_poses(path: Path) -> Doubles:
    """A file of poses, float64 (frames, 12).

    Raises
    ------
    UnexpectedLayout
        When the file is missing, or a line has not 12 finite numbers.
    """
    if not path.is_file():
        raise UnexpectedLayout(path, "there is no such file", EXPECTED)
    try:
        rows = [line.split() for line in path.read_text().splitlines() if line.strip()]
    except UnicodeDecodeError:
        raise UnexpectedLayout(path, "this is no text", EXPECTED) from None
    wrong = next((i for i, row in enumerate(rows) if len(row) != 12), None)
    if wrong is not None or not rows:
        problem = "the file is empty" if wrong is None else f"line {wrong + 1} has {len(rows[wrong])} numbers, not 12"
        raise UnexpectedLayout(path, problem, EXPECTED)
    try:
        poses = np.array(rows, np.float64)
    except ValueError as error:
        raise UnexpectedLayout(path, str(error), EXPECTED) from None
    unknown = np.flatnonzero(~np.isfinite(poses).all(axis=1))
    if len(unknown):
        raise UnexpectedLayout(path, f"line {unknown[0] + 1} has a number that is not finite", EXPECTED)
    return poses
