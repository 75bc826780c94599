"""What is fixed to a camera is read from a few views, once, and only what their recipe has."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from schemas.description import Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe
from worker.method.camera_fixed import LEAST_VIEWS
from worker.search.database_index import DatabaseCatalogue, DatabaseIndex
from worker.search.fixed_cells import FixedCells


class Reader:
    """Views whose lowest row of cells is the same; notes what is read of them."""

    def __init__(self) -> None:
        self.read: list[str] = []

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        self.read.append("cells")
        found = {}
        for seq in seqs:
            found[seq] = np.random.default_rng(seq).integers(-99, 99, (4, 6, 32)).astype(np.int8)
            found[seq][3] = np.random.default_rng(0).integers(-99, 99, (6, 32)).astype(np.int8)
        return found

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        self.read.append("local features")
        return {seq: LocalFeatures(np.zeros((0, 2), np.float32), np.zeros((0, 8), np.int8)) for seq in seqs}


def recipe(*, dense: bool = True, local_features: int | None = 300) -> DescriptionRecipe:
    parameters = SimpleNamespace(dense=SimpleNamespace() if dense else None, local_features=local_features)
    return cast(DescriptionRecipe, SimpleNamespace(id=f"{dense}-{local_features}", parameters=parameters))


SAMPLE = tuple(range(1, LEAST_VIEWS + 1))


@pytest.mark.parametrize(
    ("sample", "of", "read"),
    [
        (SAMPLE, recipe(), ["cells", "local features"]),
        (SAMPLE, recipe(local_features=None), ["cells"]),  # what is missing of a view would be taken for damage
        (SAMPLE, recipe(dense=False), []),
        (SAMPLE[1:], recipe(), []),
        ((), recipe(), []),
    ],
    ids=["default", "no keypoints", "paper", "few views", "no views"],
)
def test_only_what_the_recipe_has_is_read_and_once(
    sample: tuple[int, ...], of: DescriptionRecipe, read: list[str]
) -> None:
    reader = Reader()
    fixed = FixedCells(cast(Any, reader))
    found = [fixed.of(sample, of) for _ in range(3)]
    assert reader.read == read
    assert [one is not None for one in found] == [bool(read)] * 3
    if found[0] is not None:
        assert found[0].sure[3].all()
        assert not found[0].sure[:3].any()


def test_another_sample_is_looked_at_anew() -> None:
    reader = Reader()
    fixed = FixedCells(cast(Any, reader))
    fixed.of(SAMPLE, recipe())
    fixed.of((*SAMPLE, 99), recipe())
    assert reader.read == ["cells", "local features"] * 2


def test_a_map_made_a_moment_ago_does_not_empty_the_sample_of_another() -> None:
    """Until it is changed it has the revision of the map that was changed last, and in the database the same recipe."""
    reader, of = Reader(), recipe()
    vectors: Any = SimpleNamespace(sample=lambda map_id, recipe, count: SAMPLE if map_id == 1 else ())
    catalogue = DatabaseCatalogue(vectors, cast(Any, reader))
    made, full = (DatabaseIndex(vectors, name, map_id, of, 7, False) for name, map_id in (("new", 2), ("campus", 1)))
    assert catalogue.camera_fixed(made, of) is None
    assert catalogue.camera_fixed(full, of) is not None
