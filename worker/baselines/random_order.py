"""A random order: what luck gets in one draw. `worker.place.recall.chance` is its exact expectation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from schemas.description import Floats
from worker.baselines.baseline import Tick


class RandomOrder:
    """Uniformly random distances from a seed."""

    name = "random"

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Numbers in 0..1, float32 (queries, database)."""
        for _ in (*database, *queries):
            tick()
        return np.random.default_rng(self.seed).random((len(queries), len(database)), dtype=np.float32)
