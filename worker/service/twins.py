"""Twins: pairs of places that a map takes for each other, from the comparisons of its views with one another."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from schemas.comparisons import Comparison
from schemas.health import HealthFinding, SurveyedView
from worker.method.places import Places
from worker.service.match_standard import MatchStandard
from worker.service.spots import label

SHOWN = 10
"""Views that a finding names at most."""

REMEDY = (
    "look at the views: if it is one place, give both the same place (PATCH /views/{id}); if not, enrol both where "
    "they differ, and narrow queries there with near or place"
)


@dataclass
class _Pair:
    """What speaks for a pair of places being twins."""

    one_spot: int = 0
    fooled: int = 0
    score: float = 0.0
    views: dict[str, None] = field(default_factory=dict)
    """Ids, in the order in which they were met."""

    def add(self, score: float, *views: str) -> None:
        self.score = max(self.score, score)
        self.views.update(dict.fromkeys(views))


def find_twins(views: Sequence[SurveyedView], same_place_m: float, standard: MatchStandard) -> Iterator[HealthFinding]:
    """Twins among the views.

    Two views of places that the user tells apart, by name or by position, make twins of these when the map's own
    comparison says that both show one spot; or when the map, queried with one of them, finds the other before any
    further view of its own place; or when it would be `matched` with the other if its own place were not in the map.
    """
    of, name_of = {view.seq: view for view in views}, {view.id: view.known.name for view in views}
    places = Places({view.seq: view.known for view in views}, same_place_m)
    pairs: defaultdict[tuple[str, str], _Pair] = defaultdict(_Pair)

    def pair(one: SurveyedView, other: SurveyedView) -> _Pair:
        first, second = sorted((label(one), label(other)))
        return pairs[first, second]

    for view in views:
        compared = view.comparison
        if compared is None:
            continue
        for seq in compared.same_spot:
            other = of.get(seq)
            if other is not None and places.told_apart(view.seq, other.seq):
                found = pair(view, other)
                found.one_spot += 1
                found.add(compared.own or 0.0, view.id, other.id)
        rival = None if compared.rival is None else of.get(compared.rival)
        if rival is None or compared.level is None or not places.told_apart(view.seq, rival.seq):
            continue
        if _fools(compared, compared.level, standard):
            found = pair(view, rival)
            found.fooled += 1
            found.add(compared.level, view.id, rival.id)
    for (first, second), found in pairs.items():
        seen = [of_views for of_views in (_one_spot(found.one_spot), _fooled(found.fooled)) if of_views]
        names = {name for view in found.views if (name := name_of[view]) is not None}
        yield HealthFinding(
            "twins",
            f"the map takes {first} and {second} for each other: {' and '.join(seen)}",
            REMEDY,
            weight=found.one_spot + found.fooled + min(found.score, 1.0) / 2,
            places=tuple(sorted(names)),
            views=tuple(found.views)[:SHOWN],
            count=len(found.views),
        )


def _fools(compared: Comparison, level: float, standard: MatchStandard) -> bool:
    """Whether a query with a view would be answered with its rival, which scores `level`.

    It is when the rival comes before any further view of the own place, or would be `matched` without that place.
    """
    if compared.own is not None and level >= compared.own:
        return True
    next_best = 0.0 if compared.gap is None else level - compared.gap
    return standard.would_match(level, next_best, compared.breadth or 0.0, compared.others)


def _one_spot(count: int) -> str:
    times = "once" if count == 1 else f"{count} times"
    return f"its own comparison says {times} that views of both show one spot" if count else ""


def _fooled(count: int) -> str:
    return f"{count} view{'s' * (count != 1)} of one would be answered with the other" if count else ""
