"""Results of a search: scored views, best first."""

from collections.abc import Mapping
from dataclasses import dataclass

from schemas.description import Description
from schemas.recipe import MapRecipe
from schemas.records import MapLevels, ViewRecord
from worker.method.calibration import Calibration
from worker.method.evidence import RankedCandidate, Ranking


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
    ranking : Ranking
        All candidates.
    rival : ScoredView or None
        Best view of another place than the first one's.
    levels : MapLevels
        Of the map.
    pending : int
        Views of the map that were acknowledged and not described yet when the search began.
    revision : int
    recipe : MapRecipe
    calibration : Calibration
        Of the map's confidences.
    searched : int
        Number of views searched.
    timing_ms : mapping of stage to milliseconds
        ``search``, ``rerank``, ``verify``.
    keep_queries : int
        How many queries that matched nothing the map keeps.
    """

    views: tuple[ScoredView, ...]
    ranking: Ranking
    rival: ScoredView | None
    levels: MapLevels
    pending: int
    revision: int
    recipe: MapRecipe
    calibration: Calibration
    searched: int
    timing_ms: Mapping[str, float]
    keep_queries: int = 0


@dataclass(frozen=True, eq=False)
class MapResults:
    """What a map says of an image.

    Parameters
    ----------
    name : str
        Of the map.
    description : Description
        Of the image, by the map's recipe.
    results : RankedResults
    """

    name: str
    description: Description
    results: RankedResults
