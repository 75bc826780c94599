"""What is fixed to the cameras of maps, read from some of their views and kept while these stay the same."""

from collections.abc import Iterable

import numpy as np

from schemas.description import LocalFeatures
from schemas.draw import draw_order
from schemas.latest import Latest
from schemas.recipe import DescriptionRecipe
from worker.method.camera_fixed import LEAST_VIEWS, CameraFixed, camera_fixed
from worker.search.ports import SAMPLE, DescriptionReader

MOST_KEPT = 256
"""Samples whose outcome is kept in memory, some 100 kB each where something is fixed."""


class FixedCells:
    """What is fixed to the camera of each sample of views.

    Parameters
    ----------
    descriptions : DescriptionReader
    """

    def __init__(self, descriptions: DescriptionReader) -> None:
        self._descriptions = descriptions
        self._kept: Latest[tuple[str, tuple[int, ...]], CameraFixed | None] = Latest(MOST_KEPT)

    def among(self, seqs: Iterable[int], recipe: DescriptionRecipe) -> CameraFixed | None:
        """As `of`, by the views that an index of these would draw."""
        drawn = sorted(seqs, key=draw_order)[:SAMPLE]
        return self.of(tuple(sorted(drawn)), recipe)

    def of(self, sample: tuple[int, ...], recipe: DescriptionRecipe) -> CameraFixed | None:
        """What is fixed to the camera, by views described by a recipe; those that were deleted are left out."""
        if len(sample) < LEAST_VIEWS or recipe.parameters.dense is None:
            return None
        return self._kept.get_or_make((recipe.id, sample), lambda: self._found(sample, recipe))

    def _found(self, sample: tuple[int, ...], recipe: DescriptionRecipe) -> CameraFixed | None:
        cells = self._descriptions.cells(sample, recipe.id)
        keypoints: dict[int, LocalFeatures] = {}
        if recipe.parameters.local_features is not None:
            keypoints = self._descriptions.local_features(sample, recipe.id)
        return camera_fixed(np.stack(list(cells.values())), list(keypoints.values())) if cells else None
