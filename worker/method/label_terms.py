"""How much of a view some labels are, from its label shares."""

import numpy as np

from schemas.description import Floats

Terms = tuple[tuple[int, ...], ...]
"""Labels by their index: those of one term stand together, terms add up."""


def presence(shares: Floats, terms: Terms) -> Floats:
    """How much of each view the terms are.

    Parameters
    ----------
    shares : float32 of shape (n_views, n_labels)
        Share of each label in each view, 0 to 1.
    terms : Terms

    Returns
    -------
    float32 of shape (n_views,)
        Sum over the terms. A term of one label counts its share. One of n labels counts n times the geometric mean of
        their shares: as much as the labels alone where their shares are equal, less the more they differ, and nothing
        where one of them is missing.
    """
    of = shares.astype(np.float64)
    total = np.zeros(len(shares))
    for term in terms:
        together = of[:, list(term)]
        total += len(term) * np.prod(np.clip(together, 0.0, 1.0), axis=1) ** (1 / len(term))
    return total.astype(np.float32)
