"""Pictures and label maps from files."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]


def read_rgb(path: Path) -> Image:
    """Read a picture as RGB uint8 of shape (height, width, 3)."""
    return np.asarray(cv2.cvtColor(_read(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), np.uint8)


def read_labels(path: Path) -> Image:
    """Read a label map: uint8 of shape (height, width)."""
    return _read(path, cv2.IMREAD_GRAYSCALE)


def _read(path: Path, how: int) -> Image:
    content = cv2.imread(str(path), how)
    if content is None:
        raise ValueError(f"{path} is not a picture that OpenCV can read")
    return np.asarray(content, np.uint8)
