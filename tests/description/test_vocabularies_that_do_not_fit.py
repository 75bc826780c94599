"""Recipes that want another vocabulary than there is are refused with what can be done about it."""

from typing import Any

import pytest

from schemas.errors import InvalidParameters
from worker.description.presets import Wanted, make_recipe
from worker.encoders.color import ColorEncoder


@pytest.mark.parametrize(
    ("channels", "detail"),
    [
        ({"semantic": {"vocabulary_size": 64}}, "the recipe wants (64, "),
        ({"semantic": {"dimensions": 7}}, "the recipe to 7"),
        ({"spare": {"layer": "semantic", "vocabulary_size": 64}}, "the vocabulary has no channel 'spare'"),
    ],
)
def test_no_training_is_advised_that_would_end_in_the_same_refusal(channels: dict[str, Any], detail: str) -> None:
    with pytest.raises(InvalidParameters) as refused:
        make_recipe(ColorEncoder(), Wanted(parameters={"channels": channels}), preset="default")

    [error] = refused.value.errors
    assert detail in error.detail
    assert error.detail.endswith("trained on the map's views has the channels and sizes of the one before")
    assert "vocabulary train" not in error.detail
