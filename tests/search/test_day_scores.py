"""Scores of sure matches are gathered in memory, written once in a while, and survive a disk that is full."""

import threading
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime, timedelta, timezone

import pytest

from schemas.ageing import DayScore
from schemas.errors import DiskFull
from schemas.recipe import MapRecipe
from tests.storage.material import RECIPE, recipe
from tests.waiting import until
from worker.service import day_scores
from worker.service.day_scores import ScoreKeeper

NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


class Kept:
    """A store in memory; it refuses while it is full."""

    def __init__(self) -> None:
        self.added: list[tuple[str, str, dict[int, list[DayScore]]]] = []
        self.full = False
        self.thread: str | None = None

    def add(self, name: str, recipe: MapRecipe, scores: Mapping[int, Sequence[DayScore]]) -> None:
        if self.full:
            raise DiskFull("the disk is full")
        self.thread = threading.current_thread().name
        self.added.append((name, recipe.description.id, {seq: list(days) for seq, days in scores.items()}))


@pytest.fixture
def kept() -> Kept:
    return Kept()


def wait_for_one(kept: Kept) -> None:
    """Until something is written."""
    until(lambda: kept.added)


def test_scores_of_a_day_are_one_row(kept: Kept) -> None:
    keeper = ScoreKeeper(kept)
    for score in (0.5, 0.25):
        keeper.note("campus", RECIPE, 7, score, NOON)
    east = timezone(timedelta(hours=14))
    keeper.note("campus", RECIPE, 7, 1.0, datetime(2026, 3, 3, 1, tzinfo=east))  # the 2nd in UTC
    keeper.note("pond", RECIPE, 8, 1.0, NOON)
    assert kept.added == []
    keeper.write()
    first, second = DayScore(date(2026, 3, 1), 2, 0.75), DayScore(date(2026, 3, 2), 1, 1.0)
    of = RECIPE.description.id
    assert kept.added == [("campus", of, {7: [first, second]}), ("pond", of, {8: [DayScore(first.day, 1, 1.0)]})]
    keeper.write()
    assert len(kept.added) == 2


def test_they_are_written_by_a_thread_of_their_own(kept: Kept) -> None:
    keeper = ScoreKeeper(kept, pace_s=0.0)
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    wait_for_one(kept)
    assert kept.thread == "day scores"


def test_they_are_written_although_no_further_match_comes(kept: Kept) -> None:
    ScoreKeeper(kept, pace_s=0.0).note("campus", RECIPE, 7, 0.5, NOON)
    wait_for_one(kept)


def test_what_could_not_be_written_is_written_later_by_itself(kept: Kept) -> None:
    kept.full = True
    keeper = ScoreKeeper(kept, pace_s=0.01)
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    keeper.write()
    kept.full = False
    wait_for_one(kept)
    assert kept.added == [("campus", RECIPE.description.id, {7: [DayScore(date(2026, 3, 1), 1, 0.5)]})]


def test_nothing_is_written_after_a_stop(kept: Kept) -> None:
    kept.full = True
    keeper = ScoreKeeper(kept, pace_s=0.05)
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    keeper.stop()
    kept.full = False
    time.sleep(0.2)
    assert kept.added == []


def test_what_cannot_be_written_is_told_and_tried_again(kept: Kept, caplog: pytest.LogCaptureFixture) -> None:
    keeper = ScoreKeeper(kept)
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    kept.full = True
    keeper.write()
    assert "the disk is full" in caplog.text
    keeper.note("campus", RECIPE, 7, 0.25, NOON)
    kept.full = False
    keeper.write()
    assert kept.added == [("campus", RECIPE.description.id, {7: [DayScore(date(2026, 3, 1), 2, 0.75)]})]


def test_scores_by_another_recipe_begin_anew(kept: Kept) -> None:
    keeper, other = ScoreKeeper(kept), recipe("next")
    keeper.note("campus", RECIPE, 7, 0.5, NOON)
    kept.full = True
    keeper.write()
    keeper.note("campus", other, 7, 0.25, NOON)
    keeper.write()
    kept.full = False
    keeper.note("campus", other, 7, 0.25, NOON)
    keeper.write()
    assert kept.added == [("campus", other.description.id, {7: [DayScore(date(2026, 3, 1), 2, 0.5)]})]


def test_memory_is_bounded_while_nothing_can_be_written(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(day_scores, "MOST", 3)
    keeper = ScoreKeeper(kept)
    for seq in range(5):
        keeper.note("campus", RECIPE, seq, 0.5, NOON)
    keeper.note("campus", RECIPE, 0, 0.5, NOON)
    keeper.write()
    [(_, _, scores)] = kept.added
    assert {seq: days[0].count for seq, days in scores.items()} == {0: 2, 1: 1, 2: 1}
