"""How much of a view some labels are, from its label shares."""

from collections.abc import Sequence

import numpy as np

from schemas.description import Floats

Terms = tuple[tuple[int, ...], ...]
"""Labels by their index: those of one term stand together, terms add up."""

WHOLE = 1 - 1e-4
"""Share from which a view counts as nothing but these labels: shares are rounded."""


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


def dropped(shares: Floats, dynamic: Sequence[int], most: float = 1.0) -> Floats:
    """How much of each view is left out at most when some labels are dynamic.

    Parameters
    ----------
    shares : float32 of shape (n_views, n_labels)
        Share of each label in each view, 0 to 1.
    dynamic : sequence of int
        Labels by their index.
    most : float
        Largest share that a recipe lets go (`worker.method.static_mask.static_cells`); a view that is nothing but
        dynamic labels goes whole.

    Returns
    -------
    float32 of shape (n_views,)
        An upper bound: the margin that a recipe may ask for keeps some cells.
    """
    total = np.clip(shares[:, list(dynamic)].sum(axis=1, dtype=np.float64), 0.0, 1.0)
    return np.where(total > WHOLE, 1.0, np.minimum(total, most)).astype(np.float32)
