"""Images as small as those that tests draw: keypoints are looked for in them as they are.

The service enlarges every image to several hundred pixels before, which takes three times as long for one of
320 x 240 and thirty times for one of 64 x 48.
"""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager

from schemas.description import LocalFeatures
from schemas.image import Bytes2D

LARGEST = 400
"""Longer side of an image that is taken for small, in pixels."""

DESCRIBER = importlib.import_module("worker.description.describer")
AS_THE_SERVICE_DOES = DESCRIBER.local_features


def enlarge_less() -> None:
    """Have this process look for keypoints in small images without enlarging them."""

    def found(pixels: Bytes2D, keypoints: int, longer_side: int, equalised: bool) -> LocalFeatures:
        size = max(pixels.shape[:2])
        side = min(longer_side, size) if size <= LARGEST else longer_side
        features: LocalFeatures = AS_THE_SERVICE_DOES(pixels, keypoints, side, equalised)
        return features

    DESCRIBER.local_features = found  # type: ignore[attr-defined]


@contextmanager
def enlarging_as_the_service_does() -> Iterator[None]:
    """Context manager: small images too are enlarged, as the service does it."""
    DESCRIBER.local_features = AS_THE_SERVICE_DOES  # type: ignore[attr-defined]
    try:
        yield
    finally:
        enlarge_less()
