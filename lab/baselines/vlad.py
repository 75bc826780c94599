"""Vectors of locally aggregated descriptors: one vector for an image from any number of local ones.

Jegou et al. 2010; each word's residuals at unit length ("intra-normalisation") after Arandjelovic and Zisserman 2013.
"""

from collections.abc import Sequence

import faiss
import numpy as np

from schemas.description import Floats
from worker.method.unit_length import unit

SAMPLE = 64_000
"""Descriptors that words are learned from, at most."""

ROUNDS = 25
"""Iterations of k-means."""


def learn_words(images: Sequence[Floats], count: int, seed: int) -> Floats:
    """Learn visual words by k-means.

    Parameters
    ----------
    images : sequence of float32 of shape (descriptors, dimensions)
        One array for each image.
    count : int
        Words wanted; fewer where there are fewer descriptors, and one where there are none.
    seed : int

    Returns
    -------
    float32 of shape (words, dimensions)
    """
    descriptors = np.concatenate(images)
    if len(descriptors) == 0:
        return np.zeros((1, descriptors.shape[1]), np.float32)
    if len(descriptors) > SAMPLE:
        descriptors = descriptors[np.random.default_rng(seed).choice(len(descriptors), SAMPLE, replace=False)]
    words = min(count, len(descriptors))
    trainer = faiss.Kmeans(descriptors.shape[1], words, niter=ROUNDS, seed=seed, min_points_per_centroid=1)
    trainer.train(np.ascontiguousarray(descriptors, np.float32))
    return np.asarray(trainer.centroids, np.float32)


def vlad(descriptors: Floats, words: Floats, *, signed_roots: bool) -> Floats:
    """Aggregate the descriptors of an image.

    Parameters
    ----------
    descriptors : float32 of shape (n, dimensions)
    words : float32 of shape (words, dimensions)
    signed_roots : bool
        Take the signed square root of every number before lengths are normalised, so that a repeated pattern (a wall of
        windows) does not outweigh the rest.

    Returns
    -------
    float32 of shape (words * dimensions,)
        Unit length, word by word; zero without descriptors.

    Notes
    -----
    Hard assignment: row k is the sum of x - w_k over the descriptors x whose nearest word is w_k. Ties go to the lower
    word.
    """
    sums = np.zeros(words.shape, np.float32)
    if len(descriptors):
        nearest = np.argmin((words**2).sum(axis=1) - 2 * descriptors @ words.T, axis=1)
        np.add.at(sums, nearest, descriptors - words[nearest])
    if signed_roots:
        sums = np.sign(sums) * np.sqrt(np.abs(sums))
    return unit(unit(sums).reshape(-1))
