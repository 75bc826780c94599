"""Which calibration decides in a map: its own, or one that ships with the encoder."""

from functools import lru_cache

from schemas.recipe import MapRecipe
from schemas.records import MapRecord
from worker.description.vocabularies import SHIPPED
from worker.method.calibration import Calibration
from worker.service.calibrating import own_calibration

GENERAL = "compact-default.calibration.json"
COARSE = "compact-coarse.calibration.json"
"""For rankings that compare fewer than two views at full resolution, and so do not know how broad a lead is."""


def calibration_of(record: MapRecord) -> Calibration:
    """The calibration of a map: its own, or the shipped one."""
    return (
        shipped_calibration(record.recipe)
        if record.calibration is None
        else own_calibration(record.calibration).calibration
    )


def shipped_calibration(recipe: MapRecipe) -> Calibration:
    """The calibration shipped for a recipe, whatever its encoder: features are relative to what wrong answers get in a
    map, and so mean nearly the same for all."""
    return _calibration(COARSE if recipe.ranking.full_resolution_top_k < 2 else GENERAL)


@lru_cache
def _calibration(name: str) -> Calibration:
    return Calibration.from_json((SHIPPED / name).read_text())
