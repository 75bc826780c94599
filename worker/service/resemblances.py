"""What a view that was just described resembles in its map: the same image again, or another place."""

import logging
from dataclasses import dataclass
from typing import Literal

from schemas.comparisons import KnownView
from schemas.errors import NotFound, RevisitError, Unavailable
from schemas.records import Filters, ViewRecord
from worker.method.places import ENOUGH_PLACES, SAME_SPOT_INLIERS, SAME_SPOT_SCORE, Places
from worker.service.comparing import Descriptions
from worker.service.duplicates import NearDuplicates, detail_of, named
from worker.service.match_standard import MatchStandard
from worker.service.ports import Maps
from worker.service.results import RankedResults
from worker.service.searching import DescribedByAnother, Searcher

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
    duplicates : NearDuplicates
    """

    def __init__(self, maps: Maps, descriptions: Descriptions, searcher: Searcher, duplicates: NearDuplicates) -> None:
        self._maps, self._descriptions, self._searcher, self._duplicates = maps, descriptions, searcher, duplicates

    def of(self, view: ViewRecord, judged: bool = False) -> tuple[Resemblance, ...]:
        """What a described view resembles; empty also when that cannot be told: the view is enrolled all the same.

        `judged`: the quality gate has looked for near-duplicates and found none, so that none are looked for here.
        """
        try:
            recipe = self._maps.get(view.map).description
            description = self._descriptions.whole(view.seq, recipe)
            if description is None:
                return ()
            others = {view.map: Filters(exclude=(view.id,))}
            found = self._searcher.search(others, recipe, description, top=TOP)
            same = None if judged else self._duplicates.of(view.map, recipe.id, description, but=view.seq)
        except (NotFound, DescribedByAnother, Unavailable):  # the view, or its map, changes too fast to tell
            return ()
        except RevisitError as error:
            log.error("view %s is not compared with its map: %s", view.id, error.detail)
            return ()
        first = () if same is None else (Resemblance("duplicate", detail_of(same), same.id),)
        alike = _look_alike(view, found)
        return first if alike is None else (*first, alike)


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
        breadth = found.ranking.breadth([index[scored.seq] for scored in further], index[rival.seq])
        others = found.ranking.others  # places besides the first view's
        if others < ENOUGH_PLACES and not places.same(rival.seq, found.views[0].seq):
            others -= 1  # the rival's own
        standard = MatchStandard(ranking.precision, found.levels, found.calibration)
        wins = wins or standard.would_match(rival.score, next_best, breadth, others)
        if not wins:
            return None
    return Resemblance(
        "look-alike",
        f"the map takes it for {named(rival.view)}: if that is another place, enrol both where they differ; if it is "
        "the same, give both one place",
        rival.view.id,
    )


def _known(view: ViewRecord) -> KnownView:
    return KnownView(view.attributes.place, view.attributes.position)
