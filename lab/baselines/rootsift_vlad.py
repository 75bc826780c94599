"""The classical pipeline: RootSIFT, VLAD, and a fundamental matrix for the first answers.

RootSIFT: Arandjelovic and Zisserman 2012. Keypoints are found on equalised luminance with a low threshold of contrast,
as the service's own are (`worker.description.local_features`), so that dark rooms have some too.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from lab.baselines.baseline import Tick, euclidean, rgb
from lab.baselines.two_views import Keypoints, inliers
from lab.baselines.vlad import learn_words, vlad
from schemas.description import Floats
from worker.description.local_features import root_descriptors

KEYPOINTS = 1000
"""Keypoints of an image, at most."""

LONGER_SIDE = 640
"""Pixels to which the longer side is scaled, up or down."""

WORDS = 64

FIRST = 20
"""Answers that are ordered by their inliers."""

REMEMBERED = 1024
"""Images whose features are kept: half a megabyte each."""


class RootSift:
    """Orders answers by inliers of a fundamental matrix between RootSIFT keypoints."""

    name = "verified"

    def __init__(self) -> None:
        self.keypoints = lru_cache(maxsize=REMEMBERED)(_keypoints)

    def inliers(self, query: Path, image: Path) -> int:
        """Clear matches of two images that agree on one epipolar geometry."""
        return inliers(self.keypoints(query), self.keypoints(image))


class RootSiftVlad:
    """Euclidean distance between VLAD vectors of RootSIFT.

    Parameters
    ----------
    features : RootSift
        Shared with what orders the first answers anew, so that keypoints are found once.
    words : int
        Size of the vocabulary, learned from the database alone.
    seed : int
    """

    name = "rootsift vlad"

    def __init__(self, features: RootSift, words: int = WORDS, seed: int = 0) -> None:
        self.features, self.words, self.seed = features, words, seed

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: Tick) -> Floats:
        """Distances, float32 (queries, database)."""
        known = self._descriptors(database, tick)
        words = learn_words(known, self.words, self.seed)
        queried = self._descriptors(queries, tick)
        return euclidean(_vectors(known, words), _vectors(queried, words))

    def _descriptors(self, images: Sequence[Path], tick: Tick) -> list[Floats]:
        found = []
        for image in images:
            found.append(self.features.keypoints(image).descriptors)
            tick()
        return found


def _keypoints(path: Path) -> Keypoints:
    return Keypoints(*root_descriptors(rgb(path), KEYPOINTS, LONGER_SIDE))


def _vectors(images: Sequence[Floats], words: Floats) -> Floats:
    return np.stack([vlad(descriptors, words, signed_roots=True) for descriptors in images])
