"""What a store keeps of the scores of sure matches, day by day."""

from datetime import date, timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.ageing import DayScore
from schemas.errors import NotFound
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe
from schemas.records import Position, ViewAttributes
from tests.storage.material import RECIPE, describe_all, enroll, recipe
from worker.storage.database import Database
from worker.storage.examining import examine
from worker.storage.store import SqlStore
from worker.storage.tables import DAY_SCORES

DAY = date(2026, 3, 1)


@pytest.fixture
def campus(store: SqlStore) -> SqlStore:
    """Two views, one with a place and a position, in a map that keeps matches."""
    enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=1.0, y=2.0)))
    enroll(store, "yard")
    store.maps.change("campus", MapChanges(keep_matches=5))
    return store


def add(store: SqlStore, seq: int, *scores: tuple[int, float], by: MapRecipe = RECIPE, map: str = "campus") -> None:
    """Add scores, each with its day from `DAY` on."""
    for day, score in scores:
        store.day_scores.add(map, by, {seq: [DayScore(DAY + timedelta(days=day), 1, score)]})


def kept(store: SqlStore) -> dict[str | None, list[tuple[int, int, float]]]:
    """By place: the days from `DAY` on, the numbers and the sums."""
    return {
        view.known.name: [((one.day - DAY).days, one.count, one.total) for one in view.days]
        for view in store.day_scores.of("campus")
    }


def test_scores_of_one_day_add_up_and_days_are_in_order(campus: SqlStore) -> None:
    gate, yard = 1, 2
    add(campus, gate, (3, 0.5), (1, 0.75), (3, 0.25))
    add(campus, yard, (2, 1.0))
    assert kept(campus) == {"gate": [(1, 1, 0.75), (3, 2, 0.75)], None: [(2, 1, 1.0)]}
    assert campus.day_scores.of("campus")[0].known.position == Position(x=1.0, y=2.0)
    with pytest.raises(NotFound):
        campus.day_scores.of("moon")


def test_of_many_days_the_oldest_and_the_newest_stay(campus: SqlStore) -> None:
    before = campus.day_scores.state("campus")
    states = {before}
    for day in range(40):
        add(campus, 1, (day, 0.5))
        states.add(campus.day_scores.state("campus"))
    assert [day for day, *_ in kept(campus)["gate"]] == [*range(15), *range(25, 40)]
    assert len(states) == 41  # each other day is seen
    assert before == (0, 0)


def test_only_scores_that_compare_with_those_of_today_are_kept(campus: SqlStore) -> None:
    describe_all(campus)
    add(campus, 1, (1, 0.5), by=recipe("next"))
    assert kept(campus) == {}  # noted by a recipe that the map does not have
    add(campus, 1, (1, 0.5))
    stricter = RECIPE.ranking.model_copy(update={"precision": 0.99})
    campus.maps.change("campus", MapChanges(ranking=lambda _: stricter))
    assert kept(campus) == {"gate": [(1, 1, 0.5)]}  # the scores are the same
    other = RECIPE.ranking.model_copy(update={"candidates": RECIPE.ranking.candidates + 1})
    campus.maps.change("campus", MapChanges(ranking=lambda _: other))
    assert kept(campus) == {}
    add(campus, 1, (2, 0.75), by=RECIPE.model_copy(update={"ranking": other}))
    assert kept(campus) == {"gate": [(2, 1, 0.75)]}
    campus.maps.change("campus", MapChanges(ranking=lambda _: stricter))
    assert kept(campus) == {}


def test_nothing_is_kept_unless_the_map_keeps_matches_and_nothing_once_it_no_longer_does(campus: SqlStore) -> None:
    enroll(campus, "pier", map="harbour")
    add(campus, 3, (1, 0.5), map="harbour")
    assert campus.day_scores.of("harbour") == []
    add(campus, 3, (1, 0.5))  # a view of another map
    add(campus, 1, (1, 0.5), map="moon")
    assert kept(campus) == {}
    add(campus, 1, (1, 0.5))
    campus.maps.change("campus", MapChanges(keep_queries=0))
    assert kept(campus) == {"gate": [(1, 1, 0.5)]}
    campus.maps.change("campus", MapChanges(keep_matches=0))
    assert kept(campus) == {}


def test_scores_go_with_their_view_and_its_receipt_counts_them(campus: SqlStore) -> None:
    add(campus, 1, (1, 0.5), (2, 0.5), (3, 0.5))
    add(campus, 2, (1, 0.5))
    gate = campus.day_scores.of("campus")[0].id
    assert campus.removals.delete_view(gate).scores == 3
    assert kept(campus) == {None: [(1, 1, 0.5)]}
    add(campus, 1, (4, 0.5))  # matched before it was deleted, written after
    assert kept(campus) == {None: [(1, 1, 0.5)]}
    assert campus.removals.delete_map("campus").scores == 1


def test_a_damaged_day_is_left_out_and_the_doctor_removes_it(
    campus: SqlStore, database_url: str, data: Path, caplog: pytest.LogCaptureFixture
) -> None:
    add(campus, 1, (1, 0.5), (2, 0.5))
    database = Database(database_url)
    with database.writing() as connection:
        values = {"total": 0.9, "checksum": DAY_SCORES.c.checksum}
        second = DAY_SCORES.c.day == (DAY - date(1970, 1, 1)).days + 1
        connection.execute(sa.update(DAY_SCORES).where(second).values(values))
    database.close()

    assert kept(campus) == {"gate": [(2, 1, 0.5)]}
    assert "damaged" in caplog.text
    found = [one.where for one in examine(database_url, data) if "day_scores" in one.where]
    assert len(found) == 1
    add(campus, 1, (1, 0.25))
    assert kept(campus) == {"gate": [(1, 1, 0.25), (2, 1, 0.5)]}
    assert [one for one in examine(database_url, data) if "day_scores" in one.where] == []
