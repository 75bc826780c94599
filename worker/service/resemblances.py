"""What a view that was just described resembles in its map: the same image again, or another place."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from schemas.comparisons import KnownView
from schemas.errors import NotFound, RevisitError, Unavailable
from schemas.records import Filters, ViewRecord
from worker.method import near_duplicates
from worker.method.places import SAME_SPOT_INLIERS, SAME_SPOT_SCORE, Places
from worker.service.comparing import Descriptions
from worker.service.ports import Maps
from worker.service.results import RankedResults, ScoredView
from worker.service.searching import RecipeChanged, Searcher
from worker.service.sheets import name_of
from worker.service.twins import would_match

log = logging.getLogger("revisit.service")

TOP = 5
"""Best views that are looked at."""


@dataclass(frozen=True)
class Resemblance:
    """Something that a view resembles.

    Parameters
    ----------
    code : str
        ``duplicate``: nearly the same image is in the map; ``look-alike``: the map takes it for another place.
    detail : str
    view : str
        Id of the view that it resembles.
    """

    code: Literal["duplicate", "look-alike"]
    detail: str
    view: str


class Resemblances:
    """Queries a map with one of its own views. Nothing is encoded: the description is read from the store.

    Parameters
    ----------
    maps, descriptions
        Parts of the store.
    searcher : Searcher
    """

    def __init__(self, maps: Maps, descriptions: Descriptions, searcher: Searcher) -> None:
        self._maps, self._descriptions, self._searcher = maps, descriptions, searcher

    def of(self, view: ViewRecord) -> tuple[Resemblance, ...]:
        """What a described view resembles; empty also when that cannot be told: the view is enrolled all the same."""
        try:
            recipe = self._maps.get(view.map).description
            description = self._descriptions.whole(view.seq, recipe)
            if description is None:
                return ()
            others = {view.map: Filters(exclude=(view.id,))}
            found = self._searcher.search(others, recipe, description, top=TOP)
            same = self._duplicate(view, found)
        except (NotFound, RecipeChanged, Unavailable):  # the view, or its map, changes too fast to tell
            return ()
        except RevisitError as error:
            log.error("view %s is not compared with its map: %s", view.id, error.detail)
            return ()
        told = () if same is None else (same,)
        alike = _look_alike(view, found)
        return told if alike is None else (*told, alike)

    def _duplicate(self, view: ViewRecord, found: RankedResults) -> Resemblance | None:
        seqs = [view.seq, *(scored.seq for scored in found.views)]
        recipe = found.recipe.description.id
        for other in _same_images(self._descriptions, seqs, recipe):
            [scored] = [scored for scored in found.views if scored.seq == other]
            detail = f"nearly the same image is enrolled already, as {_named(scored)}; it adds nothing"
            return Resemblance("duplicate", detail, scored.view.id)
        return None


def _same_images(descriptions: Descriptions, seqs: Sequence[int], recipe: str) -> list[int]:
    """Which of some views, after the first, show nearly the same image as that."""
    vectors, cells = descriptions.vectors(seqs, recipe), descriptions.appearances(seqs, recipe)
    first = seqs[0]
    if first not in vectors or first not in cells:
        return []
    return [
        seq
        for seq in seqs[1:]
        if seq in vectors
        and seq in cells
        and float(np.linalg.norm(vectors[seq] - vectors[first])) <= near_duplicates.NEAR
        and near_duplicates.similarity(cells[first].coarse, cells[seq].coarse) >= near_duplicates.SAME
    ]


def _look_alike(view: ViewRecord, found: RankedResults) -> Resemblance | None:
    """The best view of a place that the user tells apart from this one's, if it would be taken for that."""
    known = {one.seq: _known(one) for one in (view, *(scored.view for scored in found.views))}
    ranking = found.recipe.ranking
    places = Places(known, ranking.same_place_m)
    apart = [scored for scored in found.views if places.told_apart(view.seq, scored.seq)]
    if not apart:
        return None
    rival = apart[0]
    own = max((scored.score for scored in found.views if scored not in apart), default=None)
    further = [scored for scored in apart[1:] if not places.same(rival.seq, scored.seq)]
    inliers = 0 if rival.verified is None else rival.verified.inliers
    if inliers < SAME_SPOT_INLIERS or rival.score < SAME_SPOT_SCORE:
        wins = own is not None and rival.score >= own
        index = {int(seq): i for i, seq in enumerate(found.ranking.seqs)}
        next_best = max((scored.score for scored in further), default=0.0)
        breadth = found.ranking.breadth(index[further[0].seq] if further else None, index[rival.seq])
        others = found.maps[0].searched
        wins = wins or would_match(
            rival.score, next_best, breadth, others, ranking.precision, found.levels, found.calibration
        )
        if not wins:
            return None
    return Resemblance(
        "look-alike",
        f"the map takes it for {_named(rival)}: if that is another place, enrol both where they differ; if it is the "
        "same, give both one place",
        rival.view.id,
    )


def _known(view: ViewRecord) -> KnownView:
    return KnownView(view.attributes.place, view.attributes.position)


def _named(scored: ScoredView) -> str:
    name = name_of(scored.view)
    return f"the view {scored.view.id}" if name == scored.view.id else f"{name!r} (view {scored.view.id})"
