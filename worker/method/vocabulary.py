"""The visual-language vocabulary: histograms over it and its training (paper, "Visual-Language Vocabulary")."""

from dataclasses import dataclass

import numpy as np

from schemas.description import Floats, Indices, Int8s
from schemas.errors import DescriptorMismatch
from schemas.recipe import Channel
from worker.method.byte_vectors import Product, float_product, quantise, scale
from worker.method.unit_length import unit

_LEAST = -(2**30)  # below any value of `closeness` in `histogram`, for bytes and for floats

BLOCK = 8192
"""Descriptors compared with all words at once in training: memory is at most BLOCK x words floats."""


@dataclass(frozen=True, eq=False)
class Projection:
    """Half-whitened principal components of histograms.

    Parameters
    ----------
    mean : float32 of shape (words,)
    matrix : float32 of shape (words, dimensions)
        Column i is component i divided by the square root of its standard deviation: full whitening would
        amplify the noise of rare words; without any the commonest words would decide alone.
    """

    mean: Floats
    matrix: Floats


@dataclass(frozen=True, eq=False)
class ChannelVocabulary:
    """Trained arrays of one channel: visual words, projection of histograms, reduction of dense cells.

    Parameters
    ----------
    words : float32 of shape (words, channels)
    projection : Projection or None
        None: the histogram itself is the vector.
    cells : float32 of shape (channels, dimensions) or None
        Reduces dense cells; None when the recipe has none.
    """

    words: Floats
    projection: Projection | None = None
    cells: Floats | None = None


def squared_distances(descriptors: Floats, words: Floats) -> Floats:
    """|x - c|^2 for all pairs, float32 (descriptors, words); at least 0."""
    cross: Floats = descriptors @ words.T
    cross *= -2
    cross += (words**2).sum(axis=1)
    cross += (descriptors**2).sum(axis=1)[:, None]
    np.maximum(cross, 0, out=cross)
    return cross


def histogram(
    descriptors: Int8s | Floats,
    words: Int8s | Floats,
    assignments: int = 1,
    temperature: float = 0.05,
    product: Product = float_product,
) -> Floats:
    """Count how often each visual-language word is the nearest one.

    Parameters
    ----------
    descriptors : float32 of shape (n, channels), or int8 as `quantise` gives them
        Embeddings at the sampled static cells, unit length.
    words : float32 or int8 of shape (words, channels)
        Of the same dtype as the descriptors.
    assignments : int
        1 counts the nearest word, a(x) = argmin_v |x - c_v|. A larger number shares a descriptor among as many nearest
        words in proportion to exp(-|x - c|^2 / (2 temperature)), for unit vectors exp(cosine / temperature).
    temperature : float
    product : Product

    Returns
    -------
    float32 of shape (words,)
        Frequencies, summing to 1; all zero without descriptors. Ties go to the word of lower index.

    Raises
    ------
    DescriptorMismatch
        Descriptors and words differ in channels.
    """
    if descriptors.shape[1] != words.shape[1]:
        raise DescriptorMismatch(got=descriptors.shape[1], want=words.shape[1])
    count = len(descriptors)
    if count == 0:
        return np.zeros(len(words), np.float32)
    # Closeness is x . c - |c|^2 / 2: its maximum over c is the minimum of |x - c|^2.
    closeness = product(descriptors, words)
    half = (words.astype(np.float32, copy=False) ** 2).sum(axis=1) / 2
    # Bytes stay whole numbers, whichever product computes them.
    closeness -= (np.floor(half) if words.dtype == np.int8 else half).astype(closeness.dtype)
    kept = min(assignments, len(words))
    nearest = np.empty((count, kept), np.intp)
    values = np.empty((count, kept), np.float32)
    rows = np.arange(count)
    for k in range(kept):  # a few passes of argmax are several times quicker than a partial sort
        nearest[:, k] = closeness.argmax(axis=1)
        values[:, k] = closeness[rows, nearest[:, k]]
        closeness[rows, nearest[:, k]] = _LEAST
    values *= scale(descriptors) * scale(words)
    weights = np.exp((values - values[:, :1]) / temperature)
    weights /= weights.sum(axis=1, keepdims=True)
    total = np.bincount(nearest.ravel(), weights.ravel(), minlength=len(words))
    return (total / count).astype(np.float32)


def vector(
    descriptors: Floats, vocabulary: ChannelVocabulary, channel: Channel, product: Product = float_product
) -> Floats:
    """Histogram of one channel, normalised and projected.

    Descriptors and words are compared as bytes, in whole numbers, so that every machine finds the same nearest words.

    Returns
    -------
    float32 of shape (channel.dimensions or words,)
        Unit length with a projection or Hellinger normalisation; sums to 1 otherwise; all zero without descriptors.
    """
    compared = quantise(descriptors), quantise(vocabulary.words)
    counts = histogram(*compared, channel.assignments, channel.temperature, product)
    if not counts.any():
        return np.zeros(channel.dimensions or len(counts), np.float32)
    normalised: Floats = np.sqrt(counts, dtype=np.float32) if channel.normalisation == "hellinger" else counts
    if vocabulary.projection is None:
        return normalised
    centred = (normalised - vocabulary.projection.mean).astype(np.float32)
    return unit(centred @ vocabulary.projection.matrix)


def train_words(
    descriptors: Floats, count: int, random: np.random.Generator, *, iterations: int = 20, spherical: bool = False
) -> Floats:
    """Cluster descriptors into words by k-means (Lloyd's, started by k-means++).

    Parameters
    ----------
    descriptors : float32 of shape (n, channels)
    count : int
        V.
    random : numpy.random.Generator
    iterations : int
        Largest number of iterations; training stops when no descriptor changes its word.
    spherical : bool
        Keep words at unit length (cosine k-means).

    Returns
    -------
    float32 of shape (count, channels)

    Raises
    ------
    ValueError
        Fewer distinct descriptors than `count`.
    """
    # Distinct rows have distinct projections, almost surely; sorting numbers is far quicker than sorting rows.
    if len(np.unique(descriptors @ random.standard_normal(descriptors.shape[1]))) < count:
        raise ValueError(f"{len(descriptors)} descriptors, with duplicates, cannot give {count} distinct words")
    words = _spread(descriptors, count, random)
    previous: Indices | None = None
    for _ in range(iterations):
        nearest, distance = _assign(descriptors, words)
        if previous is not None and np.array_equal(nearest, previous):
            break
        previous = nearest
        sizes = np.bincount(nearest, minlength=count)
        used = np.flatnonzero(sizes)
        starts = np.concatenate([[0], np.cumsum(sizes[used])[:-1]])
        sums = np.zeros_like(words, dtype=np.float64)
        sums[used] = np.add.reduceat(descriptors[np.argsort(nearest, kind="stable")], starts, axis=0, dtype=np.float64)
        words = (sums / np.maximum(sizes, 1)[:, None]).astype(np.float32)
        for empty in np.flatnonzero(sizes == 0):  # an empty cluster restarts at the descriptor furthest from its word
            worst = int(distance.argmax())
            words[empty] = descriptors[worst]
            distance[worst] = -1
        if spherical:
            words = unit(words)
    return words


def _spread(descriptors: Floats, count: int, random: np.random.Generator) -> Floats:
    """k-means++ (Arthur and Vassilvitskii 2007): starts drawn in proportion to squared distance from earlier ones."""
    chosen = [int(random.integers(len(descriptors)))]
    closest = squared_distances(descriptors, descriptors[chosen])[:, 0].astype(np.float64)
    while len(chosen) < count:
        closest[chosen] = 0
        chosen.append(int(random.choice(len(descriptors), p=closest / closest.sum())))
        np.minimum(closest, squared_distances(descriptors, descriptors[chosen[-1:]])[:, 0], out=closest)
    return descriptors[chosen].copy()


def _assign(descriptors: Floats, words: Floats) -> tuple[Indices, Floats]:
    """Nearest word of each descriptor, and the squared distance to it."""
    nearest = np.empty(len(descriptors), np.intp)
    distance = np.empty(len(descriptors), np.float32)
    for start in range(0, len(descriptors), BLOCK):
        block = slice(start, start + BLOCK)
        squared = squared_distances(descriptors[block], words)
        nearest[block] = squared.argmin(axis=1)
        distance[block] = squared.min(axis=1)
    return nearest, distance


def fit_projection(histograms: Floats, dimensions: int) -> Projection:
    """Half-whitened PCA of normalised histograms.

    Parameters
    ----------
    histograms : float32 of shape (images, words)
        Normalised as the channel's recipe says.
    dimensions : int
        At most min(images - 1, words).

    Raises
    ------
    ValueError
        Too few images or words for that many dimensions.
    """
    if dimensions > min(len(histograms) - 1, histograms.shape[1]):
        raise ValueError(f"{len(histograms)} images of {histograms.shape[1]} words cannot give {dimensions} components")
    mean = histograms.mean(axis=0)
    _, lengths, components = np.linalg.svd(histograms - mean, full_matrices=False)
    deviations = np.maximum(lengths[:dimensions] / np.sqrt(len(histograms)), 1e-6)
    # The sign of a component is arbitrary; fixing it makes the trained file the same on every machine.
    signs = np.sign(components[np.arange(dimensions), np.abs(components[:dimensions]).argmax(axis=1)])
    matrix = (components[:dimensions] * (signs / np.sqrt(deviations))[:, None]).T
    return Projection(mean.astype(np.float32), np.ascontiguousarray(matrix, np.float32))


def fit_cells(cells: Floats, dimensions: int) -> Floats:
    """Principal directions of dense cells, without their mean (cells are already centred per image).

    Parameters
    ----------
    cells : float32 of shape (n, channels)
    dimensions : int

    Returns
    -------
    float32 of shape (channels, dimensions)
        Orthonormal columns; columns beyond the number of channels are zero, so that cells of every layer have
        `dimensions` dimensions.
    """
    # The eigenvectors of the channels x channels moment matrix are the right singular vectors of `cells`.
    _, vectors = np.linalg.eigh((cells.T @ cells).astype(np.float64))
    leading = vectors[:, ::-1][:, : min(dimensions, cells.shape[1])]
    signs = np.sign(leading[np.abs(leading).argmax(axis=0), np.arange(leading.shape[1])])
    missing = dimensions - leading.shape[1]
    return np.ascontiguousarray(np.pad(leading * signs, ((0, 0), (0, missing))), np.float32)
