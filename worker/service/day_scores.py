"""Scores of sure matches, gathered in memory and written down once a minute, apart from the queries."""

import logging
import threading
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from typing import Protocol

from schemas.ageing import DayScore
from schemas.errors import RevisitError
from schemas.recipe import MapRecipe

log = logging.getLogger("revisit.service")

PACE_S = 60.0
"""Between two times that scores are written: what a crash loses at most."""

MOST = 20_000
"""Days of views that are held at most while they cannot be written."""

Sums = dict[tuple[int, date], tuple[int, float]]


class AddsScores(Protocol):
    """The part of the store that keeps scores by day."""

    def add(self, name: str, recipe: MapRecipe, scores: Mapping[int, Sequence[DayScore]]) -> None:
        """Add scores of a map by a recipe to those of the same view and day."""
        ...


class ScoreKeeper:
    """Keeps the scores of sure matches, for `worker.service.ageing`.

    Parameters
    ----------
    scores : AddsScores
    pace_s : float
        Seconds between two times that scores are written.
    """

    def __init__(self, scores: AddsScores, pace_s: float = PACE_S) -> None:
        self._scores, self._pace_s = scores, pace_s
        self._sums: dict[str, tuple[MapRecipe, Sums]] = {}
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()
        self._writing = threading.Lock()

    def note(self, name: str, recipe: MapRecipe, seq: int, score: float, now: datetime) -> None:
        """Add the score of a sure match; returns at once."""
        with self._lock:
            of, sums = self._sums.get(name, (recipe, {}))
            if of is not recipe and of != recipe:
                sums = {}  # scores by another recipe or ranking do not compare
            self._sums[name] = recipe, sums
            key = seq, now.astimezone(UTC).date()
            if key in sums or sum(len(some) for _, some in self._sums.values()) < MOST:
                count, total = sums.get(key, (0, 0.0))
                sums[key] = count + 1, total + score
            self._write_later()

    def _write_later(self) -> None:
        """Have what is held written by a thread of its own, so that no query waits for the disk."""
        if self._timer is None:
            self._timer = threading.Timer(self._pace_s, self.write)
            self._timer.name, self._timer.daemon = "day scores", True
            self._timer.start()

    def write(self) -> None:
        """Write down what was noted; what cannot be written now is logged, and tried again later."""
        with self._writing:
            with self._lock:
                noted, self._sums = self._sums, {}
                self._forget_timer()
            for name, (recipe, sums) in noted.items():
                days: dict[int, list[DayScore]] = {}
                for (seq, day), (count, total) in sums.items():
                    days.setdefault(seq, []).append(DayScore(day, count, total))
                try:
                    self._scores.add(name, recipe, days)
                except RevisitError as error:
                    log.error("scores of the map %s could not be kept: %s; they are tried again", name, error.detail)
                    self._take_back(name, recipe, sums)

    def stop(self) -> None:
        """Write for the last time; what cannot be written then is lost."""
        self.write()
        with self._lock:
            self._forget_timer()

    def _forget_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _take_back(self, name: str, recipe: MapRecipe, sums: Sums) -> None:
        """Hold what could not be written, unless the map has another recipe by now."""
        with self._lock:
            of, newer = self._sums.get(name, (recipe, {}))
            if of == recipe:
                for key, (count, total) in sums.items():
                    more, further = newer.get(key, (0, 0.0))
                    newer[key] = count + more, total + further
                self._sums[name] = recipe, newer
                self._write_later()
