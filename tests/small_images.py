"""Images of a few dozen pixels, of which tests make thousands.

The service would enlarge them ten times before it looks for keypoints, which takes longer than all else that is done
with them.
"""

from typing import Any

LARGEST = 96
"""Longer side of an image that is taken for small, in pixels."""

TIMES = 3
"""How many times larger keypoints are looked for in such an image, at most."""


def look_less_closely() -> None:
    """Have this process look for keypoints in small images without enlarging them as far as it would."""
    from worker.description import describer, local_features

    def found(pixels: Any, keypoints: int, longer_side: int, equalised: bool) -> Any:
        size = max(pixels.shape[:2])
        side = min(longer_side, TIMES * size) if size <= LARGEST else longer_side
        return local_features.local_features(pixels, keypoints, side, equalised)

    describer.local_features = found
