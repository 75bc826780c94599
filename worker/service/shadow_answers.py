"""What one recipe answers to a query of a shadow, and whether two answers say the same."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import Description
from schemas.errors import Unavailable
from schemas.records import Filters, Selection, Sequence64, ViewRecord
from schemas.shadow import ShadowAnswer
from worker.description.describer import Describer
from worker.description.scheduler import Timed
from worker.method.calibration import Verdict
from worker.method.cascade import ViewGone
from worker.method.places import Places
from worker.method.positions import distance, is_known
from worker.service.map_answers import ROUNDS, AnsweringMap


@dataclass(frozen=True)
class Side(AnsweringMap):
    """One of the two recipes; `describer` is None where it is of another encoder than the running one."""

    describer: Describer | None


@dataclass(frozen=True)
class Outcome:
    """An answer as the search gives it: the first view by its sequence number, None without any."""

    status: Verdict
    confidence: float
    first: int | None
    score: float | None
    search_ms: float


def search(side: Side, description: Description, among: Sequence64, own: int | None) -> Outcome:
    """Query a map by one recipe.

    Parameters
    ----------
    side : Side
    description : Description
        Of the query, by the side's recipe.
    among : int64 of shape (n,)
        Views that are searched, by sequence number, ascending.
    own : int or None
        The view that queries, which is left out.

    Raises
    ------
    Unavailable
        Views that were found, or the index itself, were gone before they could be ranked, `ROUNDS` times.
    """
    began = time.perf_counter()
    gone: set[int] = set() if own is None else {own}
    for _ in range(ROUNDS):
        try:
            ranking, decision = side.answer(description, Selection(among, np.array(sorted(gone), np.int64)))
        except ViewGone as error:
            gone |= error.seqs
            continue
        any_found = len(ranking.seqs) > 0
        return Outcome(
            decision.status,
            decision.confidence,
            int(ranking.seqs[0]) if any_found else None,
            float(ranking.scores[0]) if any_found else None,
            (time.perf_counter() - began) * 1000,
        )
    raise Unavailable("the map is being emptied faster than it can be searched; try again", 1)


def answer(
    found: Outcome | None, described: Timed[Description] | None, views: Mapping[int, ViewRecord], right: bool | None
) -> ShadowAnswer:
    """An answer for the table; `found` is None where the image could not be described."""
    if found is None:
        return ShadowAnswer(
            status="refused",
            confidence=0.0,
            view=None,
            place=None,
            score=None,
            right=right,
            search_ms=0.0,
            describe_ms=None,
        )
    view = None if found.first is None else views.get(found.first)
    return ShadowAnswer(
        status=found.status,
        confidence=round(found.confidence, 4),
        view=None if view is None else view.id,
        place=None if view is None else view.attributes.place,
        score=None if found.score is None else round(found.score, 4),
        right=right,
        search_ms=round(found.search_ms, 3),
        describe_ms=None if described is None else round(described.encode_ms + described.finish_ms, 3),
    )


def same_place(
    one: int | None, other: int | None, known: Callable[[list[int]], list[KnownView]], within_m: float
) -> bool:
    """Whether two first views, by sequence number, are of one place; None stands for none."""
    if one is None or other is None or one == other:
        return one == other
    try:
        both = dict(zip([one, other], known([one, other]), strict=True))
    except ViewGone:
        return False
    return Places(both, within_m).same(one, other)


def place_of(view: ViewRecord, within_m: float) -> Filters | None:
    """Selects the views of a view's place as its user told it: by its position, else its name; None when neither."""
    position, place = view.attributes.position, view.attributes.place
    if is_known(position):
        return Filters.around(position, within_m)
    return None if place is None else Filters(place=place)


def shows(view: ViewRecord | None, own: ViewRecord, within_m: float) -> bool:
    """Whether a view is of the place of another, as their user told it."""
    if view is None:
        return False
    if is_known(own.attributes.position):
        return distance(view.attributes.position, own.attributes.position) <= within_m
    return own.attributes.place is not None and view.attributes.place == own.attributes.place
