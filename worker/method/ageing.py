"""Ageing: whether the scores of a place fell over time, beyond chance and beyond what all places of its map fell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from schemas.ageing import MOST_DAYS
from schemas.description import Doubles

FEWEST_DAYS = 7
"""Days at each end below which nothing is told."""

SPAN_DAYS = 28
"""From the first day to the last at least: two weeks of sun and two of rain are no age."""

FALL = 0.1
"""Of the median score at least."""

SHARE = 0.95
"""Of the pairs of an old and a new day, those that have to fall. Of two weeks of seven days without a trend,
in random order, 1 in 858 has it (Mann and Whitney's U of 2 at most)."""

FEWEST_PLACES = 5
"""Places below which nothing is known of the map as a whole."""


@dataclass(frozen=True, eq=False)
class Trend:
    """Mean scores of a place's oldest and newest days, float64 of shape (days,) both.

    Parameters
    ----------
    old, new : float64 of shape (days,)
        Mean score of each day, 0..1.
    since, recent, until : int
        The first of the old days, the first of the new ones, the last of these, by number.
    """

    old: Doubles
    new: Doubles
    since: int
    recent: int
    until: int

    @cached_property
    def fall(self) -> float:
        """By how much the median fell; negative where it rose."""
        return float(np.median(self.old) - np.median(self.new))

    def is_ageing(self, usual: float = 0.0) -> bool:
        """Whether the scores fell, by `FALL` and `SHARE`, beyond a `usual` fall."""
        if self.fall - usual < FALL:  # as nearly everywhere
            return False
        pairs = self.old[:, None] - usual - self.new[None]
        # A tie speaks for neither.
        return float((pairs > 0).mean() + (pairs == 0).mean() / 2) >= SHARE


def trend(means: Mapping[int, float]) -> Trend | None:
    """The oldest and the newest days of a place; None where they are too few or too near.

    Parameters
    ----------
    means : mapping of int to float
        Mean score of each day that has one, 0..1, by the number of the day.
    """
    days = sorted(means)
    if len(days) < 2 * FEWEST_DAYS or days[-1] - days[0] < SPAN_DAYS:
        return None
    half = min(len(days) // 2, MOST_DAYS)
    old, new = ([means[day] for day in some] for some in (days[:half], days[-half:]))
    return Trend(np.array(old), np.array(new), days[0], days[-half], days[-1])


def usual_fall(trends: Sequence[Trend]) -> float:
    """What all places of a map fell, 0 or more: the median, where there are `FEWEST_PLACES`."""
    if len(trends) < FEWEST_PLACES:
        return 0.0
    return max(0.0, float(np.median([one.fall for one in trends])))


def fell_together(trends: Sequence[Trend]) -> bool:
    """Whether it is the map that fell, rather than single places: half of them at least, and as far as one has to."""
    ageing = sum(one.is_ageing() for one in trends)
    return usual_fall(trends) >= FALL and 2 * ageing >= len(trends)
