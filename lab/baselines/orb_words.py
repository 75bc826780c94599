"""A bag of ORB words with tf-idf: the hand-crafted rival of the paper's table (Galvez-Lopez and Tardos, 2012).

A flat vocabulary of k-means on the bits instead of DBoW2's tree: slower, not worse.
"""

from collections.abc import Sequence
from pathlib import Path

import faiss
import numpy as np

from lab.baselines.baseline import Tick, grey, orb
from schemas.description import Floats
from worker.method.unit_length import unit

SAMPLE = 64_000
"""Features that the vocabulary is trained on, at most."""


class OrbWords:
    """Cosine distance between tf-idf histograms of ORB features.

    Parameters
    ----------
    words : int
        Size of the vocabulary, trained on the database alone.
    features : int
        ORB features kept of an image.
    seed : int
    """

    name = "orb words"

    def __init__(self, words: int = 1000, features: int = 500, seed: int = 0) -> None:
        self.words, self.features, self.seed = words, features, seed

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances in 0..1, float32 (queries, database); 1 for an image without features."""
        known = [self._bits(path, tick) for path in database]
        vocabulary = self._vocabulary(np.concatenate(known))
        counts = self._counts(known, vocabulary)
        queried = self._counts([self._bits(path, tick) for path in queries], vocabulary)
        # A word in every image tells nothing; a word in none cannot be met in the database.
        seen = (counts > 0).sum(axis=0)
        idf = np.log(len(database) / np.maximum(seen, 1)).astype(np.float32)
        return 1 - unit(queried * idf) @ unit(counts * idf).T

    def _bits(self, path: Path, tick: Tick) -> Floats:
        """ORB descriptors as bits, float32 (features, 256): their squared distance is Hamming's."""
        _, descriptors = orb(grey(path), self.features)
        tick()
        if descriptors is None:
            return np.zeros((0, 256), np.float32)
        return np.unpackbits(descriptors, axis=1).astype(np.float32)

    def _vocabulary(self, features: Floats) -> Floats:
        if len(features) > SAMPLE:
            chosen = np.random.default_rng(self.seed).choice(len(features), SAMPLE, replace=False)
            features = features[chosen]
        words = min(self.words, len(features))
        if words == 0:
            return np.zeros((1, 256), np.float32)
        trainer = faiss.Kmeans(256, words, niter=15, seed=self.seed, min_points_per_centroid=1)
        trainer.train(features)
        return np.asarray(trainer.centroids, np.float32)

    @staticmethod
    def _counts(images: Sequence[Floats], vocabulary: Floats) -> Floats:
        """How often each word occurs, float32 (images, words)."""
        lengths = (vocabulary**2).sum(axis=1)
        counts = np.zeros((len(images), len(vocabulary)), np.float32)
        for row, bits in zip(counts, images, strict=True):
            if len(bits):
                nearest = np.argmin(lengths - 2 * bits @ vocabulary.T, axis=1)
                row += np.bincount(nearest, minlength=len(vocabulary))
        return counts
