"""Pictures of no place are described once and ship with the encoder."""

from pathlib import Path

import numpy as np
import pytest

from scenes.placeless import KINDS
from schemas.recipe import DescriptionRecipe
from schemas.settings import Settings
from training.commands.describe_impostors import OF_A_KIND, main
from worker.description import impostors
from worker.description.presets import Wanted, make_recipe
from worker.encoders.choosing import SHAREABLE, make_encoder


def recipe_of(encoder: str, **wanted: object) -> DescriptionRecipe:
    made, _ = make_encoder(Settings(encoder=encoder), 1)
    return make_recipe(made, Wanted(**wanted), preset="default").description  # type: ignore[arg-type]


@pytest.mark.parametrize("encoder", SHAREABLE)
def test_those_that_ship_are_of_the_recipe_that_maps_get(encoder: str) -> None:
    recipe = recipe_of(encoder)
    shipped = impostors.shipped_for(recipe)
    grid = recipe.parameters.dense

    assert shipped is not None
    assert grid is not None
    assert shipped.full.shape[:3] == (OF_A_KIND * len(KINDS), grid.rows, grid.columns)
    assert {name: of.shape[1] for name, of in shipped.vectors.items()} == {
        name: channel.length for name, channel in recipe.parameters.channels.items()
    }
    assert shipped.full.reshape(len(shipped.full), -1).any(axis=1).all()


def test_other_labels_change_nothing_and_other_cells_or_vocabularies_have_none() -> None:
    recipe = recipe_of("compact")
    assert impostors.shipped_for(recipe_of("compact", labels=("road", "building", "sky"))) is not None
    assert impostors.shipped_for(recipe_of("compact", parameters={"dense": {"rows": 8}})) is None
    assert impostors.shipped_for(recipe.model_copy(update={"vocabulary": "0" * 64})) is None
    assert impostors.shipped_for(recipe.model_copy(update={"weights": "0" * 64})) is None
    assert impostors.shipped_for(recipe_of("color")) is None


def test_the_command_writes_what_the_service_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to = tmp_path / "some.safetensors"
    main(["--encoder", "compact", "--of-a-kind", "1", "--to", str(to)])
    shipped = impostors.shipped_for(recipe_of("compact"))

    monkeypatch.setattr(impostors, "path_of", lambda encoder: to)
    impostors.read.cache_clear()
    try:
        made = impostors.shipped_for(recipe_of("compact"))
    finally:
        impostors.read.cache_clear()

    assert made is not None
    assert shipped is not None
    np.testing.assert_array_equal(made.full, shipped.full[::OF_A_KIND])
