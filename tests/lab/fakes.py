"""Retrievers that know places, and some that only pretend."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lab.datasets.dataset import Dataset
from lab.evaluation.querying import Answer
from schemas.errors import NothingStatic
from schemas.records import Position
from worker.method.calibration import Verdict


class FakeRetriever:
    """Images are files whose names are numbers: their places along a walk."""

    name, recipe = "fake", "fake-1"

    def __init__(self, similarity: Callable[[int, int], float]) -> None:
        self.similarity = similarity
        self.enrolled: dict[str, int] = {}
        self.queries: list[str] = []

    def enroll(self, image: Path, position: Position) -> str:
        if "cars" in image.name:
            raise NothingStatic("nothing but cars")
        self.enrolled[f"view-{image.stem}"] = int(image.stem)
        return f"view-{image.stem}"

    def query(self, image: Path, top: int) -> Answer:
        self.queries.append(image.stem)
        if not self.enrolled:
            return Answer(())
        scores = {view: self.similarity(int(image.stem), place) for view, place in self.enrolled.items()}
        best = sorted(scores, key=lambda view: -scores[view])[:top]
        confidence = float(np.clip(scores[best[0]], 0, 1))
        status: Verdict = "matched" if confidence > 0.5 else "no_match"
        return Answer(
            tuple(best), tuple(reversed(best)), tuple(scores[b] for b in best), confidence, status, {"total": 1.5}
        )


def walk(root: Path, count: int = 40) -> Dataset:
    """Places 0..count; every second one is enrolled, and the last quarter is asked for but nowhere near."""
    for i in range(2 * count):
        path = root / ("d" if i < count else "q") / f"{i % count}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x" * (i + 1))
    known = 3 * count // 4
    database = tuple(root / "d" / f"{i}.jpg" for i in range(known))
    queries = tuple(root / "q" / f"{i}.jpg" for i in range(count))
    positives = tuple(
        np.array([j for j in (i - 1, i, i + 1) if 0 <= j < known and i < known], np.int64) for i in range(count)
    )
    return Dataset("walk q -> d", database, queries, positives, "+-1 frame")
