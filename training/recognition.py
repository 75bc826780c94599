"""A plain place recogniser to judge networks with: histograms of visual words, and cells compared over shifts.

It is what the service does, without its verification; numbers from here compare checkpoints with each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import faiss
import numpy as np
import numpy.typing as npt

from worker.method.unit_length import unit

Floats = npt.NDArray[np.float32]

GRID = (9, 15)
SHIFTS = (2, 4)


@dataclass(frozen=True)
class Field:
    """One channel's embeddings of one picture.

    Attributes
    ----------
    cells : float16 of shape (rows * columns, channels)
        Unit length, row by row.
    shape
        Rows and columns.
    """

    cells: npt.NDArray[np.float16]
    shape: tuple[int, int]


class Histograms:
    """Soft histograms of visual words, square-rooted and reduced by half-whitened principal components.

    Parameters
    ----------
    training
        Fields of general pictures: 200 cells of each make the words, all of them the components.
    words, temperature, size, seed
        Number of words, what cosines are divided by in the soft assignment, numbers kept, seed of k-means.
    """

    def __init__(
        self, training: Sequence[Field], *, words: int = 512, temperature: float = 0.05, size: int = 128, seed: int = 0
    ) -> None:
        sample = np.concatenate(
            [
                field.cells[np.random.default_rng([seed, index]).permutation(len(field.cells))[:200]]
                for index, field in enumerate(training)
            ]
        ).astype(np.float32)
        clusters = faiss.Kmeans(sample.shape[1], words, niter=15, seed=seed, spherical=True)
        clusters.train(sample)
        self._index = faiss.IndexFlatIP(sample.shape[1])
        self._index.add(np.asarray(clusters.centroids, np.float32))
        self._size = words
        self._temperature = temperature
        raw = np.stack([self._counts(field) for field in training])
        self._mean: Floats = raw.mean(axis=0)
        _, lengths, directions = np.linalg.svd(raw - self._mean, full_matrices=False)
        spread = lengths[:size, None] / np.sqrt(len(raw))
        self._components: Floats = (directions[:size] / np.sqrt(spread)).T.astype(np.float32)

    def of(self, fields: Sequence[Field]) -> Floats:
        """Describe pictures: float32 of shape (n, size), unit length."""
        counts = np.stack([self._counts(field) for field in fields])
        return unit(((counts - self._mean) @ self._components).astype(np.float32))

    def _counts(self, field: Field) -> Floats:
        near, nearest = self._index.search(field.cells.astype(np.float32), 3)
        shares = np.exp((near - near.max(axis=1, keepdims=True)) / self._temperature)
        shares /= shares.sum(axis=1, keepdims=True)
        counts = np.bincount(nearest.ravel(), shares.ravel(), minlength=self._size).astype(np.float32)
        frequencies: Floats = np.sqrt(counts / counts.sum())
        return frequencies


class DenseCells:
    """Mean embeddings of 9 x 15 cells, without the picture's mean, reduced to a few principal directions."""

    def __init__(self, training: Sequence[Field], *, size: int = 32) -> None:
        sample = np.concatenate([pooled(field) for field in training[::3]])
        self._directions: Floats = np.linalg.svd(sample[::3], full_matrices=False)[2][:size].T

    def of(self, fields: Sequence[Field]) -> Floats:
        """Describe pictures: float32 of shape (n, 9, 15, size), unit length."""
        return np.stack([unit(pooled(field) @ self._directions).reshape(*GRID, -1) for field in fields])


def pooled(field: Field) -> Floats:
    """Average the embeddings of each of 9 x 15 cells: float32 of shape (135, channels), centred, unit length."""
    rows, columns = field.shape
    index = np.arange(rows * columns)
    cell = (index // columns * GRID[0] // rows) * GRID[1] + (index % columns) * GRID[1] // columns
    members = (cell == np.arange(GRID[0] * GRID[1])[:, None]).astype(np.float32)
    means = unit(members @ field.cells.astype(np.float32))
    return unit(means - means.mean(axis=0))


def best_shift(query: Floats, others: Floats) -> Floats:
    """Compare cells (9, 15, c) with those of others (n, 9, 15, c): greatest mean cosine over shifts, (n,)."""
    rows, columns = query.shape[:2]
    best = np.full(len(others), -1, np.float32)
    for down in range(-SHIFTS[0], SHIFTS[0] + 1):
        for right in range(-SHIFTS[1], SHIFTS[1] + 1):
            a = query[max(0, down) : rows + min(0, down), max(0, right) : columns + min(0, right)]
            b = others[:, max(0, -down) : rows + min(0, -down), max(0, -right) : columns + min(0, -right)]
            cosine = b.reshape(len(others), -1) @ a.ravel() / (a.shape[0] * a.shape[1])
            best = np.maximum(best, cosine)
    return best


def recall_at_one(scores: Floats, truth: npt.NDArray[np.bool_]) -> float:
    """Share, in percent, of queries (rows) whose best view (column) is right; those without an answer are left out.

    Ties go to the lower view.
    """
    answerable = truth.any(axis=1)
    best = np.argmax(scores[answerable], axis=1)
    return 100 * float(truth[answerable][np.arange(len(best)), best].mean())
