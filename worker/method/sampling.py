"""Sampling of descriptors among static cells (paper, "Visual-Language Vocabulary": K remaining coordinates)."""

import numpy as np

from schemas.description import Booleans, Indices


def generator(seed: int, digest: str) -> np.random.Generator:
    """Random generator of one image: the same seed and image always draw the same cells.

    Parameters
    ----------
    seed : int
        Seed of the recipe.
    digest : str
        SHA-256 of the image, hexadecimal.
    """
    return np.random.default_rng([seed, int(digest, 16)])


def draw(static: Booleans, count: int | None, random: np.random.Generator) -> Indices:
    """Draw cells uniformly, without replacement, among the static ones.

    Parameters
    ----------
    static : bool of shape (rows, columns)
    count : int or None
        K; all static cells are drawn when there are no more than `count`, or with None.
    random : numpy.random.Generator

    Returns
    -------
    intp of shape (n,)
        Flat (row-major) cell numbers, ascending.
    """
    remaining = np.flatnonzero(static)
    if count is None or len(remaining) <= count:
        return remaining
    return np.sort(random.choice(remaining, size=count, replace=False))
