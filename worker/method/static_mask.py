"""Mask of static cells (paper, "Dynamic Object Filtering")."""

import numpy as np

from schemas.description import Booleans, Floats


def static_cells(label_scores: Floats, dynamic: Booleans, margin: float = 0.0, most: float = 1.0) -> Booleans:
    """Cells whose label is not dynamic.

    With ``margin=0`` and ``most=1`` this is the paper's rule: a cell is dropped when its best label is dynamic. Outside
    its domain a network easily errs (an indoor wall labelled "train"), so a preset may require a margin and limit the
    share of the image that is dropped.

    Parameters
    ----------
    label_scores : float32 of shape (rows, columns, labels)
        Cosines, as from `labels.scores`.
    dynamic : bool of shape (labels,)
        True for labels of things that move.
    margin : float
        By how much the best dynamic label's score must exceed the best static one's, 0..2.
    most : float
        Largest share of the cells to drop, those of the largest margin first, 0..1.

    Returns
    -------
    bool of shape (rows, columns)
        True where the cell is static. When every cell has a dynamic label none is, whatever `margin` and `most`:
        the image has no static content.
    """
    if not dynamic.any():
        return np.ones(label_scores.shape[:2], dtype=np.bool_)
    if dynamic.all():
        return np.zeros(label_scores.shape[:2], dtype=np.bool_)
    # As in `labels.label_map`, ties included: the first of the largest scores decides.
    moving: Booleans = dynamic[np.argmax(label_scores, axis=-1)]
    if moving.all():
        return ~moving
    lead = label_scores[..., dynamic].max(axis=-1) - label_scores[..., ~dynamic].max(axis=-1)
    moving &= lead >= margin
    allowed = int(most * moving.size)
    excess = int(moving.sum()) - allowed
    if excess > 0:
        candidates = np.flatnonzero(moving)
        by_certainty = candidates[np.argsort(lead.ravel()[candidates], kind="stable")]
        moving.ravel()[by_certainty[:excess]] = False
    return ~moving
