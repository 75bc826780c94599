"""Videos of drawn images, for tests."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from tests.sample_images import drawn


def frames(count: int, size: int = 96) -> list[npt.NDArray[np.uint8]]:
    """Drawings of different places, BGR."""
    return [np.ascontiguousarray(drawn(size, size, i)[..., ::-1]) for i in range(count)]


def video(path: Path, images: Sequence[npt.NDArray[np.uint8]], per_second: float, codec: str = "MJPG") -> bytes:
    """The bytes of a video; its container follows from the ending of the path."""
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), per_second, (width, height))
    assert writer.isOpened()
    for image in images:
        writer.write(image)
    writer.release()
    return path.read_bytes()
