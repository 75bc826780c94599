"""Where a map's recipe differs from its preset as this version has it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pydantic import BaseModel, JsonValue

from schemas.recipe import MapRecipe
from worker.description.ports import Encoder
from worker.description.presets import PRESETS, preset_for

USERS_OWN = ("precision", "same_place_m")
"""Fields of a ranking config that the user sets for the map: naming a preset leaves them as they are."""


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


class PresetDifferences:
    """Differences of maps from their presets, as an encoder has these; each is made once.

    Parameters
    ----------
    encoder : Encoder
    """

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._presets: dict[str, tuple[Mapping[str, JsonValue], Mapping[str, JsonValue]]] = {}

    def of(self, recipe: MapRecipe) -> tuple[PresetDifference, ...]:
        """The parameters that would change if the map's own preset were named again; empty where it is unknown here."""
        name = recipe.ranking.preset
        if name not in PRESETS:
            return ()
        if name not in self._presets:
            preset = preset_for(name, self._encoder)
            self._presets[name] = _values(preset.parameters), _values(preset.ranking)
        parameters, ranking = self._presets[name]
        return (
            *_differences("parameters", _values(recipe.description.parameters), parameters),
            *_differences("ranking", _values(recipe.ranking), ranking),
        )


def _values(half: BaseModel) -> dict[str, JsonValue]:
    """The values that a preset may change."""
    return half.model_dump(mode="json", exclude={"preset", *USERS_OWN})


def _differences(
    path: str, ours: Mapping[str, JsonValue], theirs: Mapping[str, JsonValue]
) -> Iterator[PresetDifference]:
    """The differences between two objects, depth first."""
    for name in {**theirs, **ours}:
        value, preset = ours.get(name), theirs.get(name)
        if isinstance(value, dict) and isinstance(preset, dict):
            yield from _differences(f"{path}.{name}", value, preset)
        elif value != preset:
            yield PresetDifference(f"{path}.{name}", value, preset)
