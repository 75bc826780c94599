"""Scaling to unit length, at which an inner product is a cosine."""

import numpy as np
import numpy.typing as npt

from schemas.description import Floats


def unit(vectors: npt.NDArray[np.floating], negligible: float = 1e-12) -> Floats:
    """Scale to unit length along the last axis.

    Parameters
    ----------
    vectors : float of shape (..., channels)
    negligible : float
        A vector of at most this length becomes zero.

    Returns
    -------
    float32 of shape (..., channels)
    """
    lengths = np.sqrt(np.einsum("...d,...d->...", vectors, vectors))[..., None]
    scaled: Floats = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > negligible)
    return scaled.astype(np.float32, copy=False)
