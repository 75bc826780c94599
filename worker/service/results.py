"""Results of a search: scored views, best first."""

from collections.abc import Mapping
from dataclasses import dataclass

from schemas.recipe import MapRecipe
from schemas.records import ViewRecord
from worker.method.cascade import RankedCandidate


@dataclass(frozen=True, eq=False)
class ScoredView(RankedCandidate):
    """A ranked candidate with its view."""

    view: ViewRecord


@dataclass(frozen=True, eq=False)
class RankedResults:
    """Results of a search at one revision of the map and by one recipe.

    Parameters
    ----------
    views : tuple of ScoredView
        Best first.
    revision : int
    recipe : MapRecipe
    searched : int
        Number of views searched.
    timing_ms : mapping of stage to milliseconds
        ``search``, ``rerank``, ``verify``.
    """

    views: tuple[ScoredView, ...]
    revision: int
    recipe: MapRecipe
    searched: int
    timing_ms: Mapping[str, float]
