"""How much road, sky and building an image shows: the least that a segmentation can say about a place."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lab.baselines.baseline import Tick, described, euclidean
from schemas.description import Floats
from schemas.image import Image
from worker.description.ports import Encoder


class LabelShares:
    """Euclidean distance between the shares of each label, moving things left out.

    Parameters
    ----------
    encoder : Encoder
    labels, dynamic : sequence of str
        The label set, and those of it that move.
    decode : function
        From a path to a `Image`.
    """

    name = "label shares"

    def __init__(
        self, encoder: Encoder, labels: Sequence[str], dynamic: Sequence[str], decode: Callable[[Path], Image]
    ) -> None:
        self.encoder, self.decode = encoder, decode
        self.vectors = encoder.text_vectors(labels)
        self.static = np.array([label not in set(dynamic) for label in labels])

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""
        return euclidean(described(database, self._shares, tick), described(queries, self._shares, tick))

    def _shares(self, path: Path) -> Floats:
        """Share of each static label among the static cells, float32 (labels,); zeros when all cells move."""
        [field] = self.encoder.encode([self.decode(path)])
        labels = np.argmax(field.semantic @ self.vectors.T, axis=2)
        counts = np.bincount(labels.ravel(), minlength=len(self.static)) * self.static
        return np.asarray(counts / max(counts.sum(), 1), np.float32)
