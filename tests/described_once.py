"""Images that several services of a test run describe by the same recipe are described by one.

Only for tests of services: those of describing itself are about what is spared here.
"""

import importlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy.typing as npt

from schemas.description import Description, LocalFeatures, PixelField
from schemas.image import Bytes2D, Image
from tests.once import once
from worker.description.describer import Describer

DESCRIBER = importlib.import_module("worker.description.describer")
DESCRIBE = Describer.describe


def describe_once(put: Callable[[object, str, object], None] = setattr) -> None:
    """Have this process describe what no other has described; `put` replaces an attribute, and may undo it later."""
    find = DESCRIBER.local_features

    def local_features(pixels: Bytes2D, *how: object) -> LocalFeatures:
        of = (pixels.tobytes(), repr((pixels.shape, how)).encode())
        found: LocalFeatures = once(lambda: find(pixels, *how), "keypoints", *of)
        return found

    def describe(self: Describer, image: Image, field: PixelField, found: LocalFeatures | None) -> Description:
        by = (self.recipe.id, type(self._product), image.digest, field.extent)
        layers = [part for name in sorted(field.layers) for part in (name.encode(), _whole(field.layers[name]))]
        of = (repr(by).encode(), _whole(self._text), *layers)
        described = once(lambda: DESCRIBE(self, image, field, None), "description", *of)
        return replace(described, keypoints=found)

    put(DESCRIBER, "local_features", local_features)
    put(Describer, "describe", describe)


def _whole(array: npt.NDArray[Any]) -> bytes:
    return repr((array.dtype, array.shape)).encode() + array.tobytes()
