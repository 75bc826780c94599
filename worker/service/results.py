"""Results of a search: scored views, best first."""

from collections.abc import Mapping
from dataclasses import dataclass

from schemas.comparisons import MapLevels
from schemas.description import Description
from schemas.recipe import MapRecipe
from schemas.records import ViewRecord
from worker.method.calibration import Calibration
from worker.method.camera_fixed import CameraFixed
from worker.method.evidence import RankedCandidate, Ranking


@dataclass(frozen=True, eq=False)
class ScoredView(RankedCandidate):
    """A ranked candidate with its view."""

    view: ViewRecord


@dataclass(frozen=True)
class SearchedMap:
    """A map that was searched, at one revision.

    Parameters
    ----------
    name : str
    revision : int
    searched : int
        Number of views searched.
    pending : int
        Views that were acknowledged and not described yet when the search began.
    keep_queries, keep_matches : int
        How many queries the map keeps that matched nothing, and that matched a view although they look unlike it.
    number : int
        Of the map; one that is made or restored under its name has another.
    """

    name: str
    revision: int
    searched: int
    pending: int
    keep_queries: int = 0
    keep_matches: int = 0
    number: int = 0


@dataclass(frozen=True, eq=False)
class RankedResults:
    """Results of a search of one map, or of several with one recipe as if they were one.

    Parameters
    ----------
    views : tuple of ScoredView
        Best first.
    query : Description
        As it was ranked: without what is fixed to the camera.
    ranking : Ranking
        All candidates.
    rival : ScoredView or None
        Best view of another place than the first one's.
    levels : MapLevels
        What wrong answers get in the maps.
    maps : tuple of SearchedMap
        As they were asked for.
    recipe : MapRecipe
    calibration : Calibration
        Of the maps' confidences.
    timing_ms : mapping of stage to milliseconds
        ``search``, ``rerank``, ``verify``.
    fixed : tuple of CameraFixed
        What is fixed to the maps' cameras: views were compared without their cells that show it.
    """

    views: tuple[ScoredView, ...]
    query: Description
    ranking: Ranking
    rival: ScoredView | None
    levels: MapLevels
    maps: tuple[SearchedMap, ...]
    recipe: MapRecipe
    calibration: Calibration
    timing_ms: Mapping[str, float]
    fixed: tuple[CameraFixed, ...] = ()

    @property
    def searched(self) -> int:
        """Number of views searched."""
        return sum(one.searched for one in self.maps)

    @property
    def first_map(self) -> SearchedMap:
        """The map of the first view, or the first map without one."""
        name = self.views[0].view.map if self.views else self.maps[0].name
        return next(one for one in self.maps if one.name == name)


@dataclass(frozen=True, eq=False)
class SearchOutcome:
    """What maps of one recipe say of an image.

    Parameters
    ----------
    description : Description
        Of the image, by their recipe.
    results : RankedResults
    """

    description: Description
    results: RankedResults
