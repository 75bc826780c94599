"""Interim."""

import numpy as np

from schemas.description import LocalFeatures
from schemas.picture import Bytes2D


def local_features(pixels: Bytes2D, keypoints: int) -> LocalFeatures:
    """Interim."""
    return LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.int8))
