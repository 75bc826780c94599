"""Where maps differ from their presets, told of one map after the other."""

from unittest.mock import Mock

import pytest

from worker.description import vocabularies
from worker.description.preset_differences import PresetDifferences
from worker.description.presets import Wanted, make_recipe
from worker.encoders.color import ColorEncoder


def test_a_preset_is_made_once_for_all_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = ColorEncoder()
    recipe = make_recipe(encoder, Wanted(ranking={"candidates": 70}), preset="default")
    shipped = Mock(side_effect=vocabularies.shipped)
    monkeypatch.setattr(vocabularies, "shipped", shipped)

    differences = PresetDifferences(encoder)
    for _ in range(20):
        [one] = differences.of(recipe)
        assert (one.parameter, one.value, one.preset) == ("ranking.candidates", 70, 50)
    shipped.assert_called_once()
