"""What KITTI protocols are worth before any image is looked at: random and perfect rankings under each truth.

    python -m lab.benchmarks.kitti_protocols POSES/00.txt

Prints the table of docs/evaluation.md: how many queries have an answer, what a ranking by true distance in the ground
plane finds, and what a random one does, under sane and faulty ground truths.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.datasets.dataset import UnexpectedLayout, within
from lab.datasets.kitti import X, Z, read_poses
from lab.metrics.recall import DEPTHS, Indices, Truth, chance, first_right, recall
from schemas.description import Doubles

FEWEST = 2 * max(DEPTHS)
"""Frames of a drive whose halves have as many as are ranked."""

HEIGHT = 7
RADIUS_M = 25.0


@dataclass(frozen=True, eq=False)
class Protocol:
    """A split of a drive and a ground truth.

    Parameters
    ----------
    name : str
    database, queries : int64 of frames
    judged : int64 of frames
        Whose poses are taken for the queries' in the truth; other frames than `queries` is the fault of an offset.
    columns : (int, int)
        Pose columns that the truth reads as the ground plane.
    """

    name: str
    database: Indices
    queries: Indices
    judged: Indices
    columns: tuple[int, int] = (X, Z)


def protocols(frames: int) -> list[Protocol]:
    """Sane and faulty ones for a drive of so many frames."""
    every = np.arange(frames, dtype=np.int64)
    first, second = every[: frames // 2], every[frames // 2 :]
    return [
        Protocol("halves in time, x-z (right)", first, second, second),
        Protocol("halves in time, x-y (height)", first, second, second, (X, HEIGHT)),
        Protocol("halves in time, x-y, query poses not offset", first, second, every[: len(second)], (X, HEIGHT)),
        Protocol("odd and even frames, x-z", every[::2], every[1::2], every[1::2]),
    ]


def row(protocol: Protocol, poses: Doubles, depths: Sequence[int] = DEPTHS) -> tuple[float, Doubles, Doubles]:
    """(answerable share, recall@N of a ranking by true distance, of a random one), all over all queries."""
    seen = poses[:, list(protocol.columns)]
    positives = within(seen[protocol.database], seen[protocol.judged], RADIUS_M)
    truth = Truth.of(positives, len(protocol.database))
    ground = poses[:, [X, Z]]
    ranked = np.empty((len(protocol.queries), max(depths)), np.int64)
    for line, frame in zip(ranked, protocol.queries, strict=True):
        apart = ((ground[protocol.database] - ground[frame]) ** 2).sum(axis=1)
        line[:] = np.argsort(apart, kind="stable")[: max(depths)]
    perfect = recall(first_right(ranked, truth), None, depths)
    return float(truth.answerable.mean()), perfect, chance(truth, None, depths)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table for a file of poses."""
    parser = argparse.ArgumentParser(prog="revisit benchmark kitti_protocols", description=__doc__.splitlines()[0])
    parser.add_argument("poses", type=Path, help="poses/00.txt of the odometry benchmark")
    try:
        poses = read_poses(parser.parse_args(argv).poses)
    except UnexpectedLayout as refusal:
        parser.error(str(refusal))
    if len(poses) < FEWEST:
        parser.error(f"{len(poses)} poses are too short a drive: it takes {FEWEST}")
    print("| split and truth | answerable | ranked by true distance @1/5/10/20 | random @1/5/10/20 |")
    print("| --- | --- | --- | --- |")
    for protocol in protocols(len(poses)):
        answerable, perfect, lucky = row(protocol, poses)
        cells = [" / ".join(f"{v:.3f}" for v in values) for values in (perfect, lucky)]
        print(f"| {protocol.name} | {answerable:.3f} | {cells[0]} | {cells[1]} |")


if __name__ == "__main__":
    main()
