"""The table of variants, and an encoder that encodes each image once."""

import numpy as np
import pytest

from lab.ablate import VARIANTS, Measured, RememberingEncoder, as_markdown
from schemas.description import DETAIL, SEMANTIC
from schemas.image import Image
from schemas.recipe import MapRecipe
from worker.description.presets import Wanted, make_recipe
from worker.encoders.color import ColorEncoder

RECIPES = {preset: make_recipe(ColorEncoder(), Wanted(), preset=preset) for preset in ("default", "paper")}
RECIPE = RECIPES["default"]


def test_each_variant_switches_one_part() -> None:
    assert len({v.name for v in VARIANTS}) == len(VARIANTS)
    changed = {v.name: v.change(RECIPE) for v in VARIANTS}
    assert changed["default"] == RECIPE
    assert changed["hard assignment"].description.parameters.channels[DETAIL].assignments == 1
    assert changed["without dynamic filtering"].description.dynamic == ()
    flat = changed["re-ranking without dense cells"].ranking.weights
    assert (flat.dense, flat.dense_full) == (0, 0)
    assert flat.graph == RECIPE.ranking.weights.graph
    unverified = changed["re-ranking without verification"]
    assert unverified.description.parameters.local_features is None
    assert (unverified.ranking.verified_top_k, unverified.ranking.weights.verification) == (0, 0)
    assert list(changed["channel semantic alone"].description.parameters.channels) == [SEMANTIC]
    detail = changed["channel detail alone"]
    assert list(detail.ranking.weights.histogram) == [DETAIL]
    assert list(detail.description.parameters.cell_channels()) == [DETAIL]
    assert changed["histograms alone"].ranking.candidates == 0


def test_each_variant_is_a_valid_recipe_and_differs_from_its_preset() -> None:
    for variant in VARIANTS:
        plain = RECIPES[variant.preset]
        changed = variant.change(plain)
        assert MapRecipe.model_validate_json(changed.model_dump_json()) == changed, variant.name
        assert changed is plain or changed != plain, variant.name


def test_the_table_pairs_queries() -> None:
    ones, zeros = np.ones((50, 1)), np.zeros((50, 1))
    half = np.repeat([[1.0], [0.0]], 25, axis=0)
    measured = [
        Measured("default", "a", half),
        Measured("default", "b", ones),
        Measured("worse", "a", zeros),
        Measured("worse", "b", ones),
        Measured("only a", "a", half),
    ]
    lines = as_markdown(measured).splitlines()
    assert lines[2].startswith("| default | 50.0 | 100.0 |")
    assert lines[3].startswith("| worse | 0.0 | 100.0 | -25.0 ±")
    assert lines[4].startswith("| only a | 50.0 | - | +0.0 ±0.0")


def test_an_image_is_encoded_once() -> None:
    encoder = ColorEncoder()
    remembering = RememberingEncoder(encoder)
    image = Image.of(np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8))
    [first] = remembering.encode([image])
    [second] = remembering.encode([image])
    [plain] = encoder.encode([image])
    assert second is first
    assert first.semantic == pytest.approx(plain.semantic)
    assert (remembering.name, remembering.digest) == (encoder.name, encoder.digest)
