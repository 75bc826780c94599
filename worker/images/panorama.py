"""Equirectangular panoramas as what a camera would see: views in eight directions."""

import cv2
import numpy as np

from schemas.image import Bytes2D

DIRECTIONS = 8
"""Views of a panorama, each turned by 45° against the one before."""

FIELD_OF_VIEW = 90.0
"""Degrees across a view: neighbours share half of it."""

WIDEST = 1280
"""Pixels across a view at most; otherwise as many as the panorama has there."""

SHAPE = 4 / 3
QUALITY = 92


def turns() -> list[float]:
    """Degrees by which the views are turned clockwise against the middle of the panorama."""
    return [number * 360 / DIRECTIONS for number in range(DIRECTIONS)]


def views(panorama: Bytes2D) -> list[bytes]:
    """The views of a panorama as JPEG, level, in the order of `turns`; the same bytes whenever it is done.

    Parameters
    ----------
    panorama : uint8 of shape (height, width, 3)
        RGB, twice as wide as high: 360° by 180°, the horizon in the middle.

    Raises
    ------
    ValueError
        It has another shape.
    """
    height, width = panorama.shape[:2]
    if abs(width - 2 * height) > 0.02 * width:
        raise ValueError(f"is {width} x {height} pixels; an equirectangular panorama is twice as wide as high")
    return [_jpeg(perspective(panorama, turn)) for turn in turns()]


def perspective(panorama: Bytes2D, turn: float) -> Bytes2D:
    """The view of a level camera turned by `turn` degrees, out of a panorama; uint8 of shape (height, width, 3)."""
    rows, columns = panorama.shape[:2]
    width = min(WIDEST, round(columns * FIELD_OF_VIEW / 360))
    height = round(width / SHAPE)
    focal = width / 2 / np.tan(np.radians(FIELD_OF_VIEW) / 2)
    right, down = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    yaw = np.arctan2(right, focal) + np.radians(turn)
    pitch = np.arctan2(-down, np.hypot(right, focal))
    at_column = ((yaw / (2 * np.pi) + 0.5) * columns - 0.5) % columns
    at_row = (0.5 - pitch / np.pi) * rows - 0.5
    # One column more on the right, which is the first: what lies between the two edges is between their pixels.
    round_about = np.concatenate([panorama, panorama[:, :1]], axis=1)
    maps = at_column.astype(np.float32), at_row.astype(np.float32)
    return np.asarray(cv2.remap(round_about, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def _jpeg(pixels: Bytes2D) -> bytes:
    written, data = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert written, "OpenCV writes every eight-bit image as JPEG"
    return bytes(data)
