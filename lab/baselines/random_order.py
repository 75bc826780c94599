"""A random order: what luck gets in one draw. `lab.metrics.recall.chance` is its exact expectation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lab.baselines.baseline import Tick
from schemas.description import Floats


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
