"""The space in which a teacher's tokens are learned: their principal components, half-whitened.

A few components hold most of the variance of a transformer's tokens. Each is divided by the fourth root of its
variance, so that the others count too without their noise drowning these.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from schemas.description import Floats

_FILES = 1500
_TOKENS = 40
"""Sample: so many cached files, and so many tokens of one crop of each."""


@dataclass(frozen=True)
class TeacherSpace:
    """A linear map of tokens.

    Parameters
    ----------
    mean : float32 of shape (teacher's channels,)
    matrix : float32 of shape (teacher's channels, channels)
    side : int
        Tokens along either side of a crop.
    """

    mean: Floats
    matrix: Floats
    side: int

    def project(self, tokens: Floats) -> Floats:
        """Map tokens (..., teacher's channels) to unit-length vectors (..., channels)."""
        moved = (tokens - self.mean) @ self.matrix
        scaled: Floats = moved / np.maximum(np.linalg.norm(moved, axis=-1, keepdims=True), 1e-6)
        return scaled

    @classmethod
    def fit(cls, files: Sequence[Path], channels: int, seed: int = 0) -> Self:
        """Fit it to a sample of cached tokens."""
        rng = np.random.default_rng(seed)
        chosen = [files[i] for i in rng.permutation(len(files))[:_FILES]]
        rows, side = [], 0
        for path in chosen:
            crops = np.load(path, mmap_mode="r")
            crop = np.asarray(crops[rng.integers(len(crops))], np.float64)
            side = crop.shape[0]
            tokens = crop.reshape(-1, crop.shape[-1])
            rows.append(tokens[rng.choice(len(tokens), min(_TOKENS, len(tokens)), replace=False)])
        sample = np.concatenate(rows)
        values, directions = np.linalg.eigh(np.cov((sample - sample.mean(axis=0)).T))
        kept = slice(None, -channels - 1, -1)
        matrix = directions[:, kept] / np.maximum(values[kept], 1e-9) ** 0.25
        return cls(sample.mean(axis=0).astype(np.float32), matrix.astype(np.float32), side)

    def save(self, path: Path) -> None:
        """Write it as an ``.npz`` file."""
        np.savez(path, mean=self.mean, matrix=self.matrix, side=self.side)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote."""
        with np.load(path) as arrays:
            return cls(arrays["mean"], arrays["matrix"], int(arrays["side"]))
