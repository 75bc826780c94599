"""Which cells of an image are taken for things that are to be covered."""

import numpy as np

from schemas.description import Booleans, Floats

SLACK = 0.08
"""By how much another label's cosine may exceed that of a covered one: rather a wall too much than a person too few."""


def covered(label_scores: Floats, wanted: Booleans) -> Booleans:
    """Cells whose label is one of those wanted, or nearly (`SLACK`).

    Parameters
    ----------
    label_scores : float32 of shape (rows, columns, labels)
        Cosines, as from `labels.scores`.
    wanted : bool of shape (labels,)
        True for labels of things that are to be covered.

    Returns
    -------
    bool of shape (rows, columns)
    """
    if not wanted.any():
        return np.zeros(label_scores.shape[:2], np.bool_)
    if wanted.all():
        return np.ones(label_scores.shape[:2], np.bool_)
    found: Booleans = label_scores[..., wanted].max(axis=-1) >= label_scores[..., ~wanted].max(axis=-1) - SLACK
    return found
