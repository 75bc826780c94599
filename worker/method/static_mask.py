"""Leaving out what moves (paper, "Dynamic Object Filtering")."""

import numpy as np

from schemas.description import Booleans, Floats


def static_cells(word_scores: Floats, dynamic: Booleans, margin: float = 0.0, most: float = 1.0) -> Booleans:
    """Cells whose word is not dynamic.

    With ``margin=0`` and ``most=1`` this is the paper's rule: a cell goes when its best word is on the dynamic list.
    A network outside its domain is easily wrong about that (an indoor wall called "train"), so a preset may ask for
    certainty and spare most of the image.

    Parameters
    ----------
    word_scores : float32 of shape (rows, columns, words)
        Cosines, as from `labels.scores`.
    dynamic : bool of shape (words,)
        Which words move.
    margin : float
        By how much the best dynamic word must exceed the best static one. 0..2.
    most : float
        Largest share of the image to drop; beyond it only the most certain cells go. 0..1.

    Returns
    -------
    bool of shape (rows, columns)
        True where the cell stays. An image whose every cell takes a dynamic word keeps none, whatever `most` says:
        it has no static content.
    """
    if not dynamic.any():
        return np.ones(word_scores.shape[:2], dtype=np.bool_)
    if dynamic.all():
        return np.zeros(word_scores.shape[:2], dtype=np.bool_)
    # The label rule of `labels.label_map`, ties included: the first of the largest scores decides.
    moving: Booleans = dynamic[np.argmax(word_scores, axis=-1)]
    if moving.all():
        return ~moving
    lead = word_scores[..., dynamic].max(axis=-1) - word_scores[..., ~dynamic].max(axis=-1)
    moving &= lead >= margin
    allowed = int(most * moving.size)
    excess = int(moving.sum()) - allowed
    if excess > 0:
        candidates = np.flatnonzero(moving)
        by_certainty = candidates[np.argsort(lead.ravel()[candidates], kind="stable")]
        moving.ravel()[by_certainty[:excess]] = False
    return ~moving
