"""What a camera shows wherever it is: the bonnet of its vehicle, a time stamp, black bars."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from scenes.geometry import Pixels

BONNET = (52, 54, 58)
PANELS = 80
STAMP = ("CAM 03 REAR 2024-05-03 12:41", "N 51.8763 E 0.9472 12 KM/H HD")


def bonnet(pixels: Pixels, share: float = 0.2, seed: int = 0) -> Pixels:
    """The lowest `share` of the image, 0..1, covered by panels, lamps and cables: the same for the same seed."""
    rng = np.random.default_rng(seed)
    covered = pixels.copy()
    height, width = covered.shape[:2]
    below = covered[height - round(share * height) :]
    below[:] = BONNET
    for _ in range(PANELS):
        left, top = (int(rng.integers(0, side)) for side in (width, max(len(below), 1)))
        right, bottom = left + int(rng.integers(6, width // 6)), top + int(rng.integers(5, height // 12))
        paint = tuple(int(value) for value in rng.integers(20, 230, 3))
        cv2.rectangle(below, (left, top), (right, bottom), paint, -1 if rng.random() < 0.5 else 2)
    return covered


def time_stamp(pixels: Pixels) -> Pixels:
    """Two lines of text, at the top and at the bottom."""
    stamped = pixels.copy()
    height, width = stamped.shape[:2]
    for down, line in zip((0.08, 0.95), STAMP, strict=True):
        at, size = (round(0.02 * width), round(down * height)), 0.9 * width / 640
        cv2.putText(stamped, line, at, cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 2, cv2.LINE_AA)
    return stamped


def bars(pixels: Pixels, share: float = 0.25) -> Pixels:
    """Black bars above and below, each `share` of the image's height."""
    wide = round(share * pixels.shape[0])
    return np.pad(pixels, ((wide, wide), (0, 0), (0, 0)))


CARRIED: Mapping[str, Callable[[Pixels], Pixels]] = {
    "nothing": lambda pixels: pixels,
    "bonnet": bonnet,
    "large bonnet": lambda pixels: bonnet(pixels, 0.35),
    "time stamp": time_stamp,
    "bars": bars,
}
