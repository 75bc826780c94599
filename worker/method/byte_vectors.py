"""Vectors of unit length quantised to one byte a component, and their inner products."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from schemas.description import Floats, Int8s

Numbers = npt.NDArray[np.float32] | npt.NDArray[np.int32]

Product = Callable[[Int8s | Floats, Int8s | Floats], Numbers]
"""Inner products of (n, d) and (m, d) as (n, m). Those of bytes are exact whole numbers in every implementation."""

FULL_SCALE = 127
"""Byte that a component of 1 is quantised to."""


def quantise(vectors: Floats) -> Int8s:
    """Quantise vectors of length at most 1: each component times 127, rounded, int8 of the same shape."""
    return np.rint(vectors * FULL_SCALE).astype(np.int8)


def scale(vectors: Int8s | Floats) -> float:
    """Value of one unit of a component: 1 / 127 for bytes, whose products are taken unscaled and so exact; else 1."""
    return 1 / FULL_SCALE if vectors.dtype == np.int8 else 1.0


def float_product(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
    """Inner products in float32, which holds those of bytes exactly.

    Parameters
    ----------
    left : int8 or float32 of shape (n, dimensions)
    right : int8 or float32 of shape (m, dimensions)

    Returns
    -------
    float32 of shape (n, m)
    """
    products: Floats = left.astype(np.float32, copy=False) @ right.astype(np.float32, copy=False).T
    return products
