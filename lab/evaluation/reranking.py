"""First answers of any method, ordered anew by what a comparison of two images says."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from lab.datasets.dataset import Dataset
from lab.evaluation.querying import Answers, Progress, counted


class Verifier(Protocol):
    """Compares two images."""

    @property
    def name(self) -> str:
        """As it stands in tables, after the method whose answers it orders."""
        ...

    def inliers(self, query: Path, image: Path) -> int:
        """How much speaks for both showing the same place; many for much."""
        ...


@dataclass(frozen=True)
class Reranking:
    """What orders whose first answers anew.

    Parameters
    ----------
    verifier : Verifier
    of : str
        Name of a method.
    first : int
        Answers that are compared; those behind them stay behind.
    """

    verifier: Verifier
    of: str
    first: int

    def reranked(self, dataset: Dataset, answers: Answers, progress: Progress | None = None) -> Answers:
        """Answers with the first few ordered by inliers, ties as they were.

        The confidence is the number of inliers of the first answer: a score that grows with it, no probability.
        """
        name = f"{answers.method}, {self.verifier.name}"
        tick = counted(progress, name, len(answers.ranked))
        ranked = answers.ranked.copy()
        best = np.full(len(ranked), -np.finfo(np.float64).max)
        for query, row in enumerate(ranked):
            chosen = row[: self.first][row[: self.first] >= 0]
            counts = [self.verifier.inliers(dataset.queries[query], dataset.database[i]) for i in chosen.tolist()]
            order = np.argsort(-np.array(counts, np.int64), kind="stable")
            row[: len(chosen)] = chosen[order]
            best[query] = max(counts, default=best[query])
            tick()
        return Answers(name, ranked, best)
