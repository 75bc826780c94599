"""Keypoints of an image for geometric verification: SIFT on the luminance, descriptors of 48 bytes."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from schemas.description import Floats, Int8s, LocalFeatures
from schemas.image import Bytes2D
from worker.method.byte_vectors import quantise
from worker.method.unit_length import unit

LONGER_SIDE = 320
"""Pixels to which the longer side is scaled, up or down: the time of SIFT grows with the area."""

CONTRAST = 0.003
"""SIFT's contrast threshold (OpenCV's default of 0.04 leaves dark rooms without keypoints)."""

CONTRAST_EQUALISED = 0.01
"""SIFT's contrast threshold where contrast was equalised."""

CLIP_LIMIT = 2.0
"""Clip limit of CLAHE in 8 x 8 tiles, which equalises contrast before SIFT."""

PROJECTION = Path(__file__).with_name("rootsift_projection.npz")
"""Mean and first 48 principal directions of RootSIFT on many images (`training.commands.fit_rootsift_projection`)."""


def local_features(
    pixels: Bytes2D, keypoints: int, longer_side: int = LONGER_SIDE, equalised: bool = True
) -> LocalFeatures:
    """The strongest keypoints of an image.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    keypoints : int
        Number kept at most.
    longer_side : int
        Pixels to which the longer side is scaled, up or down.
    equalised : bool
        Whether contrast is equalised first (CLAHE): more keypoints in dark parts, fewer that are found again.

    Returns
    -------
    LocalFeatures
        Strongest first, ties by row, then column; empty for an image without structure. Descriptors are int8 (n, 48).

    Notes
    -----
    SIFT: Lowe 2004. RootSIFT (L1, then square root): Arandjelovic and Zisserman 2012. Deterministic.
    """
    positions, descriptors = root_descriptors(pixels, keypoints, longer_side, equalised=equalised)
    return LocalFeatures(positions, reduce(descriptors))


def root_descriptors(
    pixels: Bytes2D, keypoints: int, longer_side: int = LONGER_SIDE, upright: bool = False, equalised: bool = True
) -> tuple[Floats, Floats]:
    """Keypoints before reduction.

    Parameters
    ----------
    pixels, keypoints, longer_side, equalised
        As of `local_features`.
    upright : bool
        Describe every keypoint along the image's axes instead of its own direction.

    Returns
    -------
    positions : float32 of shape (n, 2)
    descriptors : float32 of shape (n, 128)
        RootSIFT, unit length, non-negative.
    """
    image = _luminance(pixels, longer_side)
    if equalised:
        image = cv2.createCLAHE(CLIP_LIMIT, (8, 8)).apply(image)
    threshold = CONTRAST_EQUALISED if equalised else CONTRAST
    sift = cv2.SIFT_create(nfeatures=max(1, keypoints), contrastThreshold=threshold)
    if upright:
        found, descriptors = sift.compute(image, _upright(sift.detect(image, None)))
    else:
        found, descriptors = sift.detectAndCompute(image, None)
    if descriptors is None or keypoints < 1:
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32)
    spots = np.array([(*key.pt, key.response, key.size, key.angle) for key in found], np.float32)
    order = np.lexsort((spots[:, 4], spots[:, 3], spots[:, 0], spots[:, 1], -spots[:, 2]))[:keypoints]
    positions = ((spots[order, :2] + 0.5) / max(image.shape)).astype(np.float32)
    chosen = descriptors[order]
    root = np.sqrt(chosen / np.maximum(chosen.sum(axis=1, keepdims=True), 1e-6))
    return positions, root.astype(np.float32)


def reduce(descriptors: Floats) -> Int8s:
    """RootSIFT descriptors as they are stored.

    Parameters
    ----------
    descriptors : float32 of shape (n, 128)

    Returns
    -------
    int8 of shape (n, 48)
        Centred, projected, unit length times 127.
    """
    mean, matrix = reduction()
    return quantise(unit(np.asarray((descriptors - mean) @ matrix, np.float32)))


@lru_cache(maxsize=1)
def reduction() -> tuple[Floats, Floats]:
    """The shipped mean, float32 (128,), and projection, float32 (128, 48)."""
    with np.load(PROJECTION, allow_pickle=False) as stored:
        return stored["mean"].astype(np.float32), stored["matrix"].astype(np.float32)


def _upright(found: Sequence[cv2.KeyPoint]) -> list[cv2.KeyPoint]:
    """Keypoints turned along the image's axes, once each: SIFT gives a keypoint again for each of its directions."""
    spots = {(*key.pt, key.size): key for key in found}
    for key in spots.values():
        key.angle = 0.0
    return list(spots.values())


def _luminance(pixels: Bytes2D, longer_side: int) -> Bytes2D:
    """Luminance of an image, scaled to `longer_side` pixels along its longer side; uint8 (height, width)."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    height, width = grey.shape
    scale = longer_side / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    resized: Bytes2D = cv2.resize(grey, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    return resized
