"""Places whose scores fall over time, and the kept queries that would refresh them; and places that are not matched."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from typing import Protocol

import numpy as np

from schemas.ageing import MatchedView, ScoreFall
from schemas.health import HealthFinding, SurveyedView
from schemas.inbox import Proposal, Proposals
from schemas.latest import Latest
from schemas.records import Filters, MapRecord
from worker.method.ageing import Trend, fell_together, trend, usual_fall
from worker.method.positions import is_known
from worker.service.ports import Views
from worker.service.spots import by_place, coordinates, known_position, label, names_of
from worker.service.twins import SHOWN
from worker.service.unmatched import MatchDays, unmatched

KEPT = 8
"""Maps whose trends are kept until a view is matched on another day."""


class Scores(Protocol):
    """Scores of sure matches by view and day."""

    def state(self, name: str) -> tuple[int, int]:
        """Two numbers of a map of which one changes when a view is matched on another day; raises NotFound."""
        ...

    def of(self, name: str) -> list[MatchedView]:
        """Views of a map with their scores by its present recipe and ranking; raises NotFound."""
        ...


@dataclass(frozen=True, eq=False)
class _Place:
    """Views of one place that have scores, those matched last first, and their trend."""

    views: Sequence[MatchedView]
    trend: Trend


class AgeingPlaces:
    """Finds places that age, and those that are never matched.

    Trends are kept until a view is matched on another day; the proposals are read each time.

    Parameters
    ----------
    scores : Scores
    views : Views
    proposals : function
        Name of a map to its proposals.
    write : function
        Writes down the scores that were noted last.
    """

    def __init__(
        self, scores: Scores, views: Views, proposals: Callable[[str], Proposals], write: Callable[[], None]
    ) -> None:
        self._scores, self._views, self._proposals, self._write = scores, views, proposals, write
        self._kept: Latest[str, tuple[tuple[datetime, int, tuple[int, int]], tuple[list[_Place], MatchDays]]]
        self._kept = Latest(KEPT)
        self._lock = threading.Lock()

    def of(self, record: MapRecord, groups: Sequence[Sequence[SurveyedView]]) -> list[HealthFinding]:
        """Findings of a map, in any order; none where it keeps no matches. Raises NotFound.

        `groups`: its views by place.
        """
        if record.keep_matches == 0:
            return []
        self._write()
        places, matched = self._places(record)
        return [*self._ageing(record.name, places), *unmatched(groups, matched)]

    def _ageing(self, name: str, places: Sequence[_Place]) -> list[HealthFinding]:
        trends = [one.trend for one in places]
        usual = usual_fall(trends)
        ageing = [one for one in places if one.trend.is_ageing(usual)]
        together = fell_together(trends)
        if not ageing and not together:
            return []
        proposals = self._proposals(name).proposals
        found = [_place(name, one, proposals) for one in ageing]
        return [_all(name, places, usual), *found] if together else found

    def _places(self, record: MapRecord) -> tuple[list[_Place], MatchDays]:
        with self._lock:
            state = record.created_at, record.revision, self._scores.state(record.name)
            kept = self._kept.get(record.name)
            if kept is None or kept[0] != state:
                kept = state, self._examine(record)
            self._kept[record.name] = kept
            return kept[1]

    def _examine(self, record: MapRecord) -> tuple[list[_Place], MatchDays]:
        within = record.ranking.same_place_m
        scores = self._scores.of(record.name)
        found = _trends(scores, within)
        places = [self._refreshed(record.name, one, within) if one.trend.is_ageing() else one for one in found]
        return [one for one in places if one is not None], MatchDays.of(scores)

    def _refreshed(self, name: str, place: _Place, within: float) -> _Place | None:
        """A place with the trend since its newest view was enrolled: scores of earlier days are of other views.

        As it is where no view was enrolled since the trend began; None where too few days are left.
        """
        enrolled = self._newest(name, place, within)
        if enrolled is None or enrolled < place.trend.since:
            return place
        of = trend({day: mean for day, mean in _means(place.views).items() if day > enrolled})
        return None if of is None else replace(place, trend=of)

    def _newest(self, name: str, place: _Place, within: float) -> int | None:
        """Day on which the newest described view of a place was enrolled; None where that is not known."""
        where = known_position(place.views[0])
        if place.views[0].known.name is not None:
            filters = Filters(place=place.views[0].known.name)
        elif where is None:
            return None
        else:
            filters = Filters.around(where, within)
        views, _ = self._views.list(name, filters, state="ready", newest_first=True, limit=1)
        return views[0].enrolled_at.astimezone(UTC).toordinal() if views else None


def _trends(views: Sequence[MatchedView], same_place_m: float) -> list[_Place]:
    """Places that were matched on days enough."""
    alone = [[view] for view in views if view.known.name is None and not is_known(view.known.position)]
    found = []
    for group in (*by_place(views, same_place_m), *alone):
        of = trend(_means(group))
        if of is not None:
            found.append(_Place(sorted(group, key=lambda view: view.days[-1].day, reverse=True), of))
    return found


def _means(group: Sequence[MatchedView]) -> dict[int, float]:
    """Mean score of a place on each day, by the day's ordinal."""
    sums: dict[int, tuple[int, float]] = {}
    for view in group:
        for one in view.days:
            day = one.day.toordinal()
            count, total = sums.get(day, (0, 0.0))
            sums[day] = count + one.count, total + one.total
    return {day: total / count for day, (count, total) in sums.items()}


def _place(name: str, place: _Place, proposals: Sequence[Proposal]) -> HealthFinding:
    first, fell = place.views[0], _fall(place.trend)
    proposal = _refreshing(place, proposals)
    return HealthFinding(
        "ageing",
        f"{label(first)} scores less than it did: {fell.then:.2f} on the first {fell.days} days from {fell.since} on, "
        f"{fell.now:.2f} on the last {fell.days} up to {fell.until}",
        f"enrol a photo of it as it looks now{_with(first)}" if proposal is None else _remedy(name, proposal),
        weight=place.trend.fall,
        places=names_of(place.views),
        views=tuple(view.id for view in place.views[:SHOWN]),
        count=len(place.views),
        position=known_position(first),
        scores=fell,
        proposal=None if proposal is None else proposal.queries[0],
    )


def _fall(of: Trend) -> ScoreFall:
    then, now = (float(np.median(scores)) for scores in (of.old, of.new))
    return ScoreFall(then, now, date.fromordinal(of.since), date.fromordinal(of.until), len(of.old))


def _all(name: str, places: Sequence[_Place], usual: float) -> HealthFinding:
    """The finding of a map whose places fell together."""
    fallen = sorted((one for one in places if one.trend.is_ageing()), key=lambda one: -one.trend.fall)
    since = date.fromordinal(min(one.trend.since for one in fallen))
    until = date.fromordinal(max(one.trend.until for one in fallen))
    return HealthFinding(
        "ageing",
        f"{len(fallen)} of {len(places)} places score less than they did, by {usual:.2f} in the middle, between "
        f"{since} and {until}: the season, the light or the camera is another one, rather than single places",
        "look at the camera; if it is well, take what queries left of the places as they look now: "
        f"GET /maps/{name}/proposals lists it, `./revisit inbox {name} --accept confirmed` takes it",
        weight=1.0 + usual,
        views=tuple(one.views[0].id for one in fallen[:SHOWN]),
        count=sum(len(one.views) for one in fallen),
    )


def _refreshing(place: _Place, proposals: Sequence[Proposal]) -> Proposal | None:
    """The proposal of a place's newest days that most queries confirm."""
    ids = {view.id for view in place.views}
    name = place.views[0].known.name
    fitting = [
        one
        for one in proposals
        if one.last_at.astimezone(UTC).toordinal() >= place.trend.recent
        and (one.place == name if name is not None else not ids.isdisjoint(one.matched.values()))
    ]
    return max(fitting, key=lambda one: (len(one.confirmed), len(one.queries)), default=None)


def _remedy(name: str, proposal: Proposal) -> str:
    of = f"/maps/{name}/proposals/{proposal.queries[0]}"
    accept = f"`./revisit inbox {name} --accept {proposal.queries[0]}"
    if proposal.confirmed:
        return (
            f"take the photos that queries left of it: POST {of}, or {accept}`; {len(proposal.confirmed)} agree on the "
            f"place, GET {of}/image shows one"
        )
    return (
        f"look at the photo that a query left of it, GET {of}/image; if it shows the place, take it: POST {of} with "
        f"`unconfirmed`, or {accept} --unconfirmed`"
    )


def _with(view: MatchedView) -> str:
    """How to name the place of a view in an enrolment."""
    if view.known.name is not None:
        return f", with the place {view.known.name!r}"
    where = known_position(view)
    return "" if where is None else f", with the position {coordinates(where)}"
