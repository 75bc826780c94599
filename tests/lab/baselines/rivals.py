"""Drawn places for rivals, and where their weights lie."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from lab.datasets.dataset import Dataset
from scenes import scene
from tests.stories.photos import photo

NAMES = ("mill lane", "station road", "the green", "harbour street")
DINOV2 = "dinov2_vits14_patch_8x8.onnx"


def enrolled_and_queried(folder: Path) -> tuple[list[Path], list[Path]]:
    """Drawn places, and the same from half a metre aside, turned by three degrees, a little darker."""
    folder.mkdir(parents=True, exist_ok=True)
    database: list[Path] = []
    queries: list[Path] = []
    for name in NAMES:
        one = scene(name).sized(320, 240)
        for files, what, look in (
            (database, "database", one.seen_from()),
            (queries, "query", one.seen_from(dx=0.5, turn=3).at("overcast")),
        ):
            path = folder / f"{what} {name}.jpg"
            path.write_bytes(photo(look))
            files.append(path)
    return database, queries


def as_dataset(database: Sequence[Path], queries: Sequence[Path]) -> Dataset:
    """The drawn places as a set: query i shows database image i."""
    right = tuple(np.array([i], np.int64) for i in range(len(queries)))
    return Dataset("drawn", tuple(database), tuple(queries), right, "the same place")


def weights(*names: str) -> list[Path]:
    """Files in the folder `RIVALS_WEIGHTS`; the test is skipped, and says so, where they are not there."""
    folder = os.environ.get("RIVALS_WEIGHTS")
    files = [Path(folder or "nowhere") / name for name in names]
    if missing := [file.name for file in files if not file.is_file()]:
        pytest.skip(
            f"NOT RUN: needs {', '.join(missing)}, which are not shipped (docs/research/evaluation.md says where they "
            "can be had); set RIVALS_WEIGHTS to a folder that holds them"
        )
    return files
