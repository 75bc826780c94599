"""Labels of the cells of an image (paper, eq. 1 and 2)."""

import numpy as np
import numpy.typing as npt

from schemas.description import Floats

LabelMap = npt.NDArray[np.int16]


def scores(embeddings: Floats, text_vectors: Floats) -> Floats:
    """Inner products of cells and labels: f_ijk = <I_ij, T_k>.

    Parameters
    ----------
    embeddings : float32 of shape (rows, columns, channels)
        Unit length.
    text_vectors : float32 of shape (labels, channels)
        Length at most 1, see `Encoder.text_vectors`.

    Returns
    -------
    float32 of shape (rows, columns, labels)
        Cosines.
    """
    product: Floats = embeddings @ text_vectors.T
    return product


def label_map(label_scores: Floats) -> LabelMap:
    """Index of the label with the largest score, per cell; ties go to the lowest index.

    Parameters
    ----------
    label_scores : float32 of shape (rows, columns, labels)

    Returns
    -------
    int16 of shape (rows, columns)
    """
    best: LabelMap = np.argmax(label_scores, axis=-1).astype(np.int16)
    return best


def shares(labels: LabelMap, count: int) -> Floats:
    """Share of the cells that have each label.

    Parameters
    ----------
    labels : int16 of shape (rows, columns)
    count : int
        Number of labels.

    Returns
    -------
    float32 of shape (count,)
        Sums to 1.
    """
    counts = np.bincount(labels.ravel(), minlength=count)
    return (counts / max(labels.size, 1)).astype(np.float32)
