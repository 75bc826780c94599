"""The list of maps is that of those there are, whoever makes or deletes one meanwhile, and takes one look."""

from functools import partial
from typing import Any
from unittest.mock import Mock

import pytest
import sqlalchemy as sa

from schemas.records import Position, ViewAttributes
from tests.storage.material import NOW, RECIPE, describe_all, enroll
from worker.service.maps import MapService
from worker.storage.store import SqlStore


def service_of(store: SqlStore, **maps: Any) -> MapService:
    """The use-cases around maps; `maps` in place of the store's methods."""
    parts = dict.fromkeys(("removals", "jobs", "uploads", "describers", "catalogue", "blurring", "wake"), Mock())
    there = {name: getattr(store.maps, name) for name in ("all", "counts", "counts_of_all")}
    return MapService(
        maps=Mock(**there | maps), comparisons=store.comparisons, encoder=Mock(meanings=lambda labels: ()),
        preset="default", shipped=Mock(), **parts,
    )  # fmt: skip


@pytest.mark.parametrize("read", ["all", "counts_of_all"])
def test_a_map_deleted_while_maps_are_listed_is_left_out_and_a_new_one_is_counted(store: SqlStore, read: str) -> None:
    for name in ("attic", "campus", "depot"):
        store.maps.put(name, RECIPE, NOW)

    def meanwhile() -> Any:
        found = getattr(store.maps, read)()
        store.removals.delete_map("campus")
        enroll(store, "gate", map="shed")
        return found

    listed = service_of(store, **{read: meanwhile}).all()
    new = ["shed"] if read == "counts_of_all" else []
    assert [state.record.name for state in listed] == ["attic", "depot", *new]
    assert [state.counts.views["pending"] for state in listed] == [0, 0, *(1 for _ in new)]


def test_all_maps_are_counted_as_each_by_itself(store: SqlStore) -> None:
    store.maps.put("empty", RECIPE, NOW)
    for name, lon in (("pacific", 179.0), ("pacific", -178.0), ("alps", 7.5), ("alps", 8.5)):
        enroll(store, f"{lon}", map=name, attributes=ViewAttributes("pass", Position(lat=46.0, lon=lon)))
    describe_all(store)
    enroll(store, "pending", map="alps")
    enroll(store, "gone", map="deleted")
    store.removals.delete_map("deleted")

    counted = store.maps.counts_of_all()
    assert counted == {name: store.maps.counts(name) for name in ("empty", "pacific", "alps")}
    assert (counted["pacific"].lowest.lon, counted["pacific"].highest.lon) == (179.0, -178.0)
    assert (counted["alps"].views, counted["alps"].places) == ({"pending": 1, "ready": 2, "failed": 0}, 1)


def test_maps_that_stay_the_same_are_not_read_one_by_one(store: SqlStore) -> None:
    service = service_of(store)
    statements: list[str] = []
    count = partial(lambda statements, *event: statements.append(event[2]), statements)
    for number in range(30):
        enroll(store, "gate", map=f"map {number}")
    service.all()
    sa.event.listen(store._database.engine, "before_cursor_execute", count)
    assert len(service.all()) == 30
    assert len(statements) < 15
