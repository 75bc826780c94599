"""Whether two images show the same thing from two places: matches of local features, and an epipolar geometry.

The classical check of a first answer (Hartley and Zisserman, 2004). Rivals are ordered by it; the service verifies by
an affine transform instead (`worker.method.verification`).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from lab.metrics.recall import Indices
from schemas.description import Booleans, Floats

EPIPOLAR = 3 / 640
"""Largest distance of an inlier from its epipolar line, as a fraction of the longer side."""

RATIO = 0.8
"""A match is clear where the nearest descriptor is nearer than this times the second nearest (Lowe 2004)."""

FEWEST = 8
"""Matches below which there is no fundamental matrix to speak of: seven fit any."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Local features of an image.

    Parameters
    ----------
    positions : float32 of shape (n, 2)
        x and y, as fractions of the image's longer side.
    descriptors : float32 of shape (n, dimensions)
        Compared by Euclidean distance.
    """

    positions: Floats
    descriptors: Floats


def clear_matches(query: Floats, image: Floats, ratio: float = RATIO) -> Indices:
    """Pairs of descriptors that are nearest to each other, and clearly so.

    Parameters
    ----------
    query, image : float32 of shape (n, dimensions) and (m, dimensions)
        Unit length.
    ratio : float
        Largest quotient of the distances to the nearest and to the second nearest, in the image.

    Returns
    -------
    int64 of shape (matches, 2)
        Indices into `query` and `image`, ascending by the first. No two pairs share a descriptor.
    """
    if len(query) == 0 or len(image) < 2:
        return np.zeros((0, 2), np.int64)
    products = query @ image.T
    nearest = products.argmax(axis=1)
    rows = np.arange(len(query))
    best = products[rows, nearest]
    mutual = products.argmax(axis=0)[nearest] == rows
    products[rows, nearest] = -np.inf
    # |a - b|^2 = 2 - 2 a.b at unit length.
    near, next_near = 2 - 2 * best, 2 - 2 * products.max(axis=1)
    chosen = rows[mutual & (np.maximum(near, 0) < ratio**2 * np.maximum(next_near, 0))]
    return np.stack([chosen, nearest[chosen]], axis=1).astype(np.int64)


def fundamental(source: Floats, target: Floats) -> Booleans:
    """Inliers of a fundamental matrix by MAGSAC (Barath et al. 2019), seeded; none with fewer than eight matches.

    Parameters
    ----------
    source, target : float32 of shape (matches, 2)
        Positions, as fractions of each image's longer side.

    Returns
    -------
    bool of shape (matches,)
    """
    nobody = np.zeros(len(source), np.bool_)
    if len(source) < FEWEST:
        return nobody
    parameters = cv2.UsacParams()
    parameters.randomGeneratorState, parameters.threshold, parameters.confidence = 0, EPIPOLAR * 1000, 0.999
    parameters.maxIterations, parameters.score = 1000, cv2.SCORE_METHOD_MAGSAC
    try:
        found, mask = cv2.findFundamentalMat(source * 1000, target * 1000, parameters)
    except cv2.error:  # OpenCV 5.0 fails on an assertion where no sample of matches gives a matrix
        return nobody
    return nobody if found is None or mask is None else mask.ravel().astype(np.bool_)


def inliers(query: Keypoints, image: Keypoints) -> int:
    """How many clear matches of two images agree on one epipolar geometry."""
    pairs = clear_matches(query.descriptors, image.descriptors)
    return int(fundamental(query.positions[pairs[:, 0]], image.positions[pairs[:, 1]]).sum())
