"""Where a map's recipe differs from its preset as this version has it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pydantic import BaseModel, JsonValue

from schemas.recipe import MapRecipe
from worker.description.ports import Encoder
from worker.description.presets import PRESETS, preset_for

USERS_OWN = ("precision", "same_place_m")
"""Of a ranking, what is the user's word on the map and no part of how it ranks: it stays whatever preset is named."""


@dataclass(frozen=True)
class PresetDifference:
    """A parameter whose value in a map is another than in its preset.

    Parameters
    ----------
    parameter : str
        Path as in a request: ``ranking.weights.graph``, ``parameters.local_features``.
    value, preset : JSON value
        In the map and in the preset; None where it has none.
    """

    parameter: str
    value: JsonValue
    preset: JsonValue


def preset_differences(recipe: MapRecipe, encoder: Encoder) -> tuple[PresetDifference, ...]:
    """What naming a map's own preset would change of its parameters and ranking; nothing of a preset unknown here."""
    name = recipe.ranking.preset
    if name not in PRESETS:
        return ()
    preset = preset_for(name, encoder)
    return (
        *_differences("parameters", _values(recipe.description.parameters), _values(preset.parameters)),
        *_differences("ranking", _values(recipe.ranking), _values(preset.ranking)),
    )


def _values(half: BaseModel) -> dict[str, JsonValue]:
    """What a preset may change."""
    return half.model_dump(mode="json", exclude={"preset", *USERS_OWN})


def _differences(
    path: str, ours: Mapping[str, JsonValue], theirs: Mapping[str, JsonValue]
) -> Iterator[PresetDifference]:
    """Those of two objects, depth first."""
    for name in {**theirs, **ours}:
        value, preset = ours.get(name), theirs.get(name)
        if isinstance(value, dict) and isinstance(preset, dict):
            yield from _differences(f"{path}.{name}", value, preset)
        elif value != preset:
            yield PresetDifference(f"{path}.{name}", value, preset)
