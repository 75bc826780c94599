"""Images and label maps from files."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8]


def read_rgb(path: Path) -> Pixels:
    """Read an image as RGB: uint8 of shape (height, width, 3).

    Raises
    ------
    ValueError
        OpenCV cannot read the file.
    """
    return np.asarray(cv2.cvtColor(_read(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), np.uint8)


def read_labels(path: Path) -> Pixels:
    """Read a label map: uint8 label values of shape (height, width); raises as `read_rgb`."""
    return _read(path, cv2.IMREAD_GRAYSCALE)


def _read(path: Path, flags: int) -> Pixels:
    content = cv2.imread(str(path), flags)
    if content is None:
        raise ValueError(f"{path} is not an image that OpenCV can read")
    return np.asarray(content, np.uint8)
