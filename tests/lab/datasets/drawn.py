"""Tiny images in the layouts of real sets."""

from pathlib import Path

import cv2
import numpy as np


def image(path: Path, seed: int = 0) -> Path:
    """A 32 x 32 image of noise, made where it is asked for."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (32, 32, 3), dtype=np.uint8)
    assert cv2.imwrite(str(path), pixels)
    return path
