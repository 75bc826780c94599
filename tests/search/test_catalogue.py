"""The catalogue answers with an index and the map of one revision."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from schemas.description import Appearance, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.records import Changes, MapRecord
from tests.storage.material import NOW, RECIPE
from worker.search.catalogue import Catalogue
from worker.search.flat_index import FlatIndex


class Store:
    """One map, which somebody changes whenever its views are read."""

    def __init__(self, changes: list[MapRecord]) -> None:
        self.record = MapRecord("campus", 1, RECIPE.description, RECIPE.ranking, NOW)
        self._changes = changes

    def numbers(self) -> set[int]:
        return {self.record.number}

    def get(self, name: str) -> MapRecord:
        return self.record

    def description(self, recipe: str) -> DescriptionRecipe:
        return self.record.description

    def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
        if self._changes:
            self.record = self._changes.pop(0)
        nothing = np.zeros(0, np.int64)
        return Changes(self.record.revision, self.record.description.id, nothing, np.zeros((0, 8), np.float32), nothing)

    def count_described(self, name: str, recipe: str) -> int:
        return 0

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        return {}

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        return {}

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        return {}


def test_a_change_between_the_two_reads_is_in_both() -> None:
    """An answer names the index's revision: it must be ranked and calibrated as of that one."""
    base = MapRecord("campus", 1, RECIPE.description, RECIPE.ranking, NOW)
    ranked = replace(base, revision=2, ranking=RankingConfig(candidates=7))
    store = Store([ranked, replace(ranked, revision=3, calibration="own")])
    channels = RECIPE.description.parameters.channels.items()
    catalogue = Catalogue(
        store, store, lambda recipe: FlatIndex({name: channel.length for name, channel in channels}, recipe.id)
    )

    for _ in range(2):
        index, record = catalogue.index("campus")
        assert index.revision == record.revision
    assert (record.revision, record.calibration, record.ranking.candidates) == (2, None, 7)
