"""Two walks along the same way, frame by frame."""

from pathlib import Path

import numpy as np

from lab.datasets.dataset import Dataset, UnexpectedLayout, images_in

EXPECTED = """\
  ROOT/database/   images of the first walk
  ROOT/query/      images of the second; number i shows the place of number i of the first
in natural order of their names (img2 before img10), equally many; other folder names by option."""


def read(root: Path, *, database: str = "database", query: str = "query", tolerance: int = 2) -> list[Dataset]:
    """One set whose right answers are the frames of the same number, give or take.

    Parameters
    ----------
    root : Path
    database, query : str
        Names of the two folders.
    tolerance : int
        Frames by which a right answer may differ.

    Raises
    ------
    UnexpectedLayout
        When a folder is missing or empty, or they differ in number: then they cannot be aligned.
    """
    first, second = images_in(root / database, EXPECTED), images_in(root / query, EXPECTED)
    if len(first) != len(second):
        problem = f"{len(first)} images in {database}, {len(second)} in {query}: these are not aligned"
        raise UnexpectedLayout(root, problem, EXPECTED)
    n = len(first)
    positives = tuple(np.arange(max(0, i - tolerance), min(n, i + tolerance + 1), dtype=np.int64) for i in range(n))
    truth = f"the frame of the same number, +-{tolerance}"
    name = f"{root.name} {query} -> {database}"
    return [Dataset(name, tuple(first), tuple(second), positives, truth)]
