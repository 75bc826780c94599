"""Covers parts of an image by what surrounds them. Nothing of a covered pixel is in the result."""

import cv2
import numpy as np
import numpy.typing as npt

from schemas.description import Booleans
from schemas.image import Bytes2D

MARGIN = 0.012
"""By how much covered parts are widened, as a share of the image's longer side: about 6 pixels of 480."""

LONGEST = 256
"""Longer side in pixels at which the fill is made; it is smooth, so that it loses nothing by that."""

LONGEST_JPEG = 65_500
"""Longest side of a JPEG, in pixels."""

QUALITIES = (92, 80, 60)
"""Of a JPEG; the later ones where the earlier ones make too many bytes."""

NOTHING_LEFT = 127
"""Level of an image that is covered entirely."""

_Floats = npt.NDArray[np.float32]


def mask_of(cells: Booleans, width: int, height: int, margin: float = MARGIN) -> Booleans:
    """Covered cells as pixels, with a margin.

    Parameters
    ----------
    cells : bool of shape (rows, columns)
        Of the whole image, True where it is to be covered.
    width, height : int
        Of the image, in pixels.
    margin : float
        Share of the longer side.

    Returns
    -------
    bool of shape (height, width)
    """
    # Linear, so that every pixel is covered that a covered cell takes part in.
    enlarged = cv2.resize(cells.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.25
    reach = max(1, round(margin * max(width, height)))
    # Counts within a square are running sums: unlike a dilation they cost the same for any reach.
    square = (2 * reach + 1, 2 * reach + 1)
    counts = cv2.boxFilter(
        enlarged.astype(np.uint8), cv2.CV_32S, square, normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(counts > 0, np.bool_)


def filled(pixels: Bytes2D, mask: Booleans) -> Bytes2D:
    """An image whose masked pixels are a smooth blend of those around them.

    The blend is made of pixels outside the mask alone: whatever lay under the mask, the result is the same.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
    mask : bool of shape (height, width)

    Returns
    -------
    uint8 of shape (height, width, 3)
        A copy; equal to `pixels` outside the mask.
    """
    result = pixels.copy()
    if not mask.any():
        return result
    if mask.all():
        result[:] = NOTHING_LEFT
        return result
    result[mask] = 0
    height, width = mask.shape
    scale = min(1.0, LONGEST / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    weight: _Floats = np.asarray(cv2.resize((~mask).astype(np.float32), size, interpolation=cv2.INTER_AREA), np.float32)
    summed: _Floats = np.asarray(cv2.resize(result, size, interpolation=cv2.INTER_AREA), np.float32)
    blend = _pulled(summed, weight)
    blend = np.asarray(cv2.resize(blend, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    result[mask] = np.clip(np.rint(blend[mask]), 0, 255).astype(np.uint8)
    return result


def _pulled(summed: _Floats, weight: _Floats) -> _Floats:
    """Weighted means where there is weight; elsewhere those of ever larger surroundings (push and pull).

    `summed` is (rows, columns, 3), the values times their weights; `weight` (rows, columns), 0..1.
    """
    mean: _Floats = np.asarray(summed / np.maximum(weight, 1e-6)[..., None], np.float32)
    if weight.min() >= 1 or max(weight.shape) == 1:
        return mean
    rows, columns = weight.shape
    half = (max(1, (columns + 1) // 2), max(1, (rows + 1) // 2))
    total = np.asarray(cv2.resize(weight, half, interpolation=cv2.INTER_AREA), np.float32)
    coarse_sum = np.asarray(cv2.resize(summed, half, interpolation=cv2.INTER_AREA), np.float32)
    # A cell with any weight counts in full on the coarser level, so that it speaks for the gap beside it.
    known = np.minimum(1, total * 4)
    spread = np.asarray(coarse_sum / np.maximum(total, 1e-6)[..., None] * known[..., None], np.float32)
    coarse = _pulled(spread, np.asarray(known, np.float32))
    around = np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_LINEAR), np.float32)
    share = np.minimum(1, weight)[..., None]
    return np.asarray(mean * share + around * (1 - share), np.float32)


def encoded(pixels: Bytes2D, most: int) -> tuple[bytes, str]:
    """An image as bytes without metadata, at most `most` of them where that is possible, and the name of its format.

    A JPEG, of the best quality that fits; PNG where a side is too long for JPEG.
    """
    if max(pixels.shape[:2]) > LONGEST_JPEG:
        return _written(".png", pixels, []), "png"
    data = b""
    for quality in QUALITIES:
        data = _written(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) <= most:
            break
    return data, "jpeg"


def _written(suffix: str, pixels: Bytes2D, options: list[int]) -> bytes:
    written, data = cv2.imencode(suffix, cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), options)
    assert written, "OpenCV writes every eight-bit image of this size"
    return bytes(data)
