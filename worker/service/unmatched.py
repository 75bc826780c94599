"""Places that no query was surely matched with, while others of their map were."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, date
from typing import Self

from schemas.ageing import MatchedView
from schemas.health import HealthFinding, SurveyedView
from worker.method.ageing import FEWEST_DAYS, SPAN_DAYS
from worker.service.spots import known_position, label, names_of
from worker.service.twins import SHOWN


@dataclass(frozen=True)
class MatchDays:
    """Sure matches of a map by its present recipe and ranking.

    Parameters
    ----------
    views : frozenset of str
        Ids of those that were matched.
    days : tuple of int
        Ordinals of the days on which any was, ascending.
    """

    views: frozenset[str]
    days: tuple[int, ...]

    @classmethod
    def of(cls, views: Sequence[MatchedView]) -> Self:
        """Those of the scores that are kept."""
        days = {one.day.toordinal() for view in views for one in view.days}
        return cls(frozenset(view.id for view in views), tuple(sorted(days)))


def unmatched(places: Sequence[Sequence[SurveyedView]], matched: MatchDays) -> Iterator[HealthFinding]:
    """Places none of whose views was matched, on days enough on which others were; those of most days weigh most.

    Days count after the place's first view was enrolled; there have to be as many, over as long, as for a place that
    ages.
    """
    for group in places:
        if not matched.views.isdisjoint(view.id for view in group):
            continue
        since = min(view.enrolled_at.astimezone(UTC).toordinal() for view in group)
        days = [day for day in matched.days if day > since]
        if len(days) < FEWEST_DAYS or days[-1] - days[0] < SPAN_DAYS:
            continue
        first = group[0]
        yield HealthFinding(
            "never-matched",
            f"{label(first)} was matched on none of the {len(days)} days on which others were, from "
            f"{date.fromordinal(days[0])} to {date.fromordinal(days[-1])}",
            "query there: if it is not matched, enrol it as it looks now; if nobody comes there, it may be deleted",
            weight=float(len(days)),
            places=names_of(group),
            views=tuple(view.id for view in group[:SHOWN]),
            count=len(group),
            position=known_position(first),
        )
