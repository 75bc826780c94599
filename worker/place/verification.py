"""Interim."""

from dataclasses import dataclass

import numpy as np

from schemas.description import Floats, LocalFeatures


@dataclass(frozen=True, eq=False)
class Verified:
    """Geometric agreement."""

    inliers: int
    matches: int
    transform: Floats | None
    pairs: Floats


def verify(query: LocalFeatures, view: LocalFeatures) -> Verified:
    """Interim."""
    return Verified(0, 0, None, np.zeros((0, 4), np.float32))


def gated_bonus(inliers: np.ndarray) -> Floats:
    """Interim."""
    m = np.median(inliers) if len(inliers) else 0
    return np.minimum(np.maximum(inliers - m - 4, 0) / (m + 8), 1).astype(np.float32)
