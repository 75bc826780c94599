"""Records of how well views were matched, day by day."""

from dataclasses import dataclass
from datetime import date

from schemas.comparisons import KnownView

MOST_DAYS = 15
"""Oldest days of a view that are kept at most, and newest ones as many."""


@dataclass(frozen=True)
class DayScore:
    """Sure matches of a view on one day, UTC.

    Parameters
    ----------
    day : date
    count : int
        How many there were, at least 1.
    total : float
        Sum of their scores, each 0..1.
    """

    day: date
    count: int
    total: float


@dataclass(frozen=True)
class MatchedView:
    """A view with the days on which it was surely matched, oldest first, all by scores that compare."""

    id: str
    known: KnownView
    days: tuple[DayScore, ...]


@dataclass(frozen=True)
class ScoreFall:
    """How far the scores of a place fell.

    Parameters
    ----------
    then, now : float
        Medians of the mean scores of the oldest and of the newest days, 0..1.
    since, until : date
        The first day and the last one.
    days : int
        Days that each median is of.
    """

    then: float
    now: float
    since: date
    until: date
    days: int
