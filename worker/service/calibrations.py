"""Which calibration decides in a map: its own, or one that ships with the encoder."""

from functools import lru_cache

from schemas.recipe import MapRecipe
from schemas.records import MapRecord
from worker.description.vocabularies import SHIPPED
from worker.method.calibration import Calibration
from worker.service.calibrating import own_calibration

GENERAL_CALIBRATION = "compact-default.calibration.json"


def calibration_of(record: MapRecord) -> Calibration:
    """The calibration of a map: its own, or the shipped one."""
    return (
        shipped_calibration(record.recipe)
        if record.calibration is None
        else own_calibration(record.calibration).calibration
    )


def shipped_calibration(recipe: MapRecipe) -> Calibration:
    """The calibration shipped for a recipe's encoder and preset, or the general one: its features are relative to what
    wrong answers get in a map, and so mean nearly the same for all of them."""
    name = f"{recipe.description.encoder}-{recipe.ranking.preset}.calibration.json"
    return _calibration(name if (SHIPPED / name).exists() else GENERAL_CALIBRATION)


@lru_cache
def _calibration(name: str) -> Calibration:
    return Calibration.from_json((SHIPPED / name).read_text())
