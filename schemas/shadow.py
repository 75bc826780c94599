"""Records of shadows: a recipe beside that of a map, and what both answer."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal, get_args

from schemas.recipe import MapRecipe
from schemas.records import JobRecord

ShadowState = Literal["describing", "comparing", "ready"]
Verdict = Literal["matched", "ambiguous", "no_match", "refused"]
Source = Literal["kept", "view"]

DEFAULT_QUERIES, MOST_QUERIES = 100, 200


@dataclass(frozen=True)
class ShadowAnswer:
    """What one recipe answers to a query.

    Parameters
    ----------
    status : str
        ``refused``: the image cannot be described by this recipe.
    confidence : float
        That the first place is right, 0..1.
    view, place : str or None
        Id of the first view, and the name of its place.
    score : float or None
        Of the first view, 0..1.
    right : bool or None
        Whether the first place is that of the view which queried; None where that is not known.
    search_ms : float
        Milliseconds of search, ranking and verdict.
    describe_ms : float or None
        Milliseconds of encoding and describing; None for a view, whose description is stored.
    """

    status: Verdict
    confidence: float
    view: str | None
    place: str | None
    score: float | None
    right: bool | None
    search_ms: float
    describe_ms: float | None


@dataclass(frozen=True)
class ShadowQuery:
    """A query and what both recipes answer.

    Parameters
    ----------
    id : str
        Of the kept query, or of the view.
    source : str
        ``kept``: a query that the map kept; ``view``: a view of the map, itself left out.
    place : str or None
        Name of the view's own place.
    at : datetime
        When it was queried, or enrolled.
    old, new : ShadowAnswer
    same_place : bool
        Whether the first views are of one place, or neither answer has one.
    """

    id: str
    source: Source
    place: str | None
    at: datetime
    old: ShadowAnswer
    new: ShadowAnswer
    same_place: bool

    @property
    def agree(self) -> bool:
        """Whether both give the same verdict and, unless it is none, the same first place."""
        return self.old.status == self.new.status and (self.same_place or self.old.status in ("no_match", "refused"))

    @property
    def changed_first(self) -> bool:
        """Whether the first places differ, and at least one answer names its one."""
        names_one = {"matched", "ambiguous"}.intersection((self.old.status, self.new.status))
        return bool(names_one) and not self.same_place


@dataclass(frozen=True)
class ShadowTable:
    """What the queries were answered by both recipes.

    Parameters
    ----------
    wanted : int
        Number of queries that were asked for.
    recipe, ranking : str
        Ids of those that the map would change over to.
    old_recipe, old_ranking : str
        Ids of those that the map had.
    old_views, new_views : int
        Views that each recipe describes.
    old_compared, new_compared : int
        Views whose comparison with their map the verdicts rest on.
    queries : tuple of ShadowQuery
        Those that do not agree first.
    """

    wanted: int
    recipe: str
    ranking: str
    old_recipe: str
    old_ranking: str
    old_views: int
    new_views: int
    old_compared: int
    new_compared: int
    queries: tuple[ShadowQuery, ...]

    def as_result(self) -> dict[str, Any]:
        """Result of the job: the columns of the table, its totals and its rows."""
        facts = {name: value for name, value in vars(self).items() if name != "queries"}
        rows = [{**asdict(one), "at": one.at.isoformat(), "agree": one.agree} for one in self.queries]
        return {**facts, "totals": self.totals(), "queries": rows}

    def totals(self) -> dict[str, Any]:
        """Counts over all queries, and mean times."""
        rows = self.queries
        return {
            "queries": len(rows),
            "kept": sum(one.source == "kept" for one in rows),
            "views": sum(one.source == "view" for one in rows),
            "agree": sum(one.agree for one in rows),
            "changed_first": sum(one.changed_first for one in rows),
            "became_matched": sum(one.old.status != "matched" and one.new.status == "matched" for one in rows),
            "stopped_matching": sum(one.old.status == "matched" and one.new.status != "matched" for one in rows),
            "known": sum(one.old.right is not None for one in rows),
            "old": _side([one.old for one in rows]),
            "new": _side([one.new for one in rows]),
        }


def _side(answers: list[ShadowAnswer]) -> Mapping[str, Any]:
    """Counts and mean times of one recipe's answers."""
    described = [one.describe_ms for one in answers if one.describe_ms is not None]
    searched = [one.search_ms for one in answers if one.status != "refused"]
    return {
        **{status: sum(one.status == status for one in answers) for status in get_args(Verdict)},
        "right": sum(one.right is True for one in answers),
        "search_ms": _mean(searched),
        "describe_ms": _mean(described),
    }


def _mean(values: list[float]) -> float | None:
    return round(sum(values) / len(values), 3) if values else None


@dataclass(frozen=True)
class ShadowRecord:
    """A map's shadow.

    Parameters
    ----------
    map : str
    state : str
        ``describing`` its views, ``comparing`` answers, or ``ready`` to be decided on.
    job : JobRecord
        Its result is the table when the shadow is ready.
    recipe : MapRecipe
        What the map would change over to.
    """

    map: str
    state: ShadowState
    job: JobRecord
    recipe: MapRecipe

    @property
    def wanted(self) -> int:
        """Number of queries that were asked for."""
        return int((self.job.result or {}).get("wanted", DEFAULT_QUERIES))
