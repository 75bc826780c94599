"""Description to ranked views: search, re-rank, verify."""

from collections.abc import Mapping
from dataclasses import dataclass

from schemas.description import ContextGraph
from schemas.ports import Store
from schemas.recipe import Recipe
from schemas.records import ViewRecord
from worker.indexes.catalogue import Catalogue
from worker.place import verification

ROUNDS = 3
"""How often a search starts anew because a view it found was deleted meanwhile."""


@dataclass(frozen=True, eq=False)
class Dense:
    """Comparison of dense cells: per channel, and the shift (rows, columns) that fits best."""

    channels: Mapping[str, float]
    shift: tuple[int, int]


@dataclass(frozen=True, eq=False)
class GraphEvidence:
    """Comparison of context graphs, with the pairs (query node, view node) and their cosines."""

    similarity: float
    view: ContextGraph
    pairs: tuple[tuple[int, int], ...]
    cosines: tuple[float, ...]
    edges_agreeing: int


@dataclass(frozen=True, eq=False)
class Found:
    """One view that may show the place.

    Parameters
    ----------
    score : float
        0..1.
    parts : mapping of term to float
        Sum to the score.
    distances, ranks : mapping of channel
        L2 between histogram vectors; rank in that channel's search, None when outside its candidates.
    """

    view: ViewRecord
    score: float
    parts: Mapping[str, float]
    distances: Mapping[str, float]
    ranks: Mapping[str, int | None]
    dense: Dense | None
    graph: GraphEvidence | None
    verified: "verification.Verified | None"


@dataclass(frozen=True, eq=False)
class Answer:
    """What a search found, best first, at one revision of the map and by one recipe."""

    found: tuple[Found, ...]
    revision: int
    recipe: Recipe
    searched: int
    timing_ms: Mapping[str, float]


class Searcher:
    """Ranks the views of a map against a description. Answers only depend on description, map revision and request.

    Parameters
    ----------
    store : Store
    catalogue : Catalogue
    """

    def __init__(self, store: Store, catalogue: Catalogue) -> None:
        self._store = store
        self._catalogue = catalogue
