"""Records of a map's health: which views are compared for it, what is read of them, and what is found."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal, get_args

from schemas.ageing import ScoreFall
from schemas.comparisons import Comparison, KnownView
from schemas.records import Position

Code = Literal["twins", "ageing", "never-matched", "duplicates", "missing-directions", "single-view", "gap"]

CODES: tuple[Code, ...] = get_args(Code)
"""Kinds of findings, those that make answers wrong first."""


@dataclass(frozen=True)
class Uncompared:
    """Views of a map whose comparison is missing or was made when the map was less than half as large, or, of a small
    map, of another size."""

    map: str
    recipe: str
    seqs: tuple[int, ...]
    among: int


@dataclass(frozen=True)
class SurveyedView:
    """A view as a map's health is read from it; `comparison` is None until it is compared."""

    id: str
    seq: int
    known: KnownView
    enrolled_at: datetime
    comparison: Comparison | None


@dataclass(frozen=True)
class HealthFinding:
    """One thing that a map lacks or suffers from.

    Parameters
    ----------
    code : str
        ``twins``: two places that the map takes for each other; ``ageing``: a place whose scores fall over time, or all
        of the map, then without `places`; ``never-matched``: a place that no query was matched with while others were;
        ``duplicates``: views that add nothing to one another;
        ``missing-directions``, ``single-view``: a place seen too narrowly; ``gap``: a stretch without views.
    detail, remedy : str
        What was found, and what to do.
    weight : float
        The larger, the more it matters among findings of its kind.
    places : tuple of str
        Names of the places concerned, where they have names.
    views : tuple of str
        Ids of views that show it, those that matter most first.
    count : int
        How many views it concerns.
    position : Position or None
        Where to go to mend it.
    headings : tuple of float
        Directions to photograph, degrees.
    scores : ScoreFall or None
        How far they fell.
    proposal : str or None
        Id of the proposal whose queries would refresh the place.
    """

    code: Code
    detail: str
    remedy: str
    weight: float
    places: tuple[str, ...] = ()
    views: tuple[str, ...] = ()
    count: int = 0
    position: Position | None = None
    headings: tuple[float, ...] = ()
    scores: ScoreFall | None = None
    proposal: str | None = None


@dataclass(frozen=True)
class HealthReport:
    """What is known of a map's health at a revision.

    Parameters
    ----------
    views, examined, compared : int
        Described views; the newest of them, which were examined; those among these that the map was queried with.
    findings : tuple of HealthFinding
        By code in the order of `CODES`, the largest weight first.
    """

    map: str
    revision: int
    views: int
    examined: int
    compared: int
    findings: tuple[HealthFinding, ...] = field(default=())
