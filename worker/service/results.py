"""What a search gives: scored views, best first."""

from collections.abc import Mapping
from dataclasses import dataclass

from schemas.recipe import MapRecipe
from schemas.records import ViewRecord
from worker.method.cascade import RankedCandidate


@dataclass(frozen=True, eq=False)
class ScoredView(RankedCandidate):
    """A ranked candidate, and the view that it is."""

    view: ViewRecord


@dataclass(frozen=True, eq=False)
class RankedResults:
    """What a search found, best first, at one revision of the map and by one recipe.

    Parameters
    ----------
    views : tuple of ScoredView
    revision : int
    recipe : MapRecipe
    searched : int
        How many views the search looked at.
    timing_ms : mapping of stage to milliseconds
        ``search``, ``rerank``, ``verify``.
    """

    views: tuple[ScoredView, ...]
    revision: int
    recipe: MapRecipe
    searched: int
    timing_ms: Mapping[str, float]
