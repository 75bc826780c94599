"""The list of maps is that of those there are, whoever deletes one meanwhile."""

from unittest.mock import Mock

from schemas.records import MapCounts
from tests.storage.material import NOW, RECIPE
from worker.service.maps import MapService
from worker.storage.store import SqlStore


def test_a_map_deleted_while_maps_are_listed_is_left_out(store: SqlStore) -> None:
    for name in ("attic", "campus", "depot"):
        store.maps.put(name, RECIPE, NOW)

    def counts(name: str) -> MapCounts:
        if name == "campus":
            store.removals.delete_map(name)
        return store.maps.counts(name)

    maps = Mock(all=store.maps.all, counts=counts)
    parts = dict.fromkeys(("removals", "jobs", "uploads", "describers", "catalogue", "blurring", "wake"), Mock())
    service = MapService(
        maps=maps, comparisons=store.comparisons, encoder=Mock(meanings=lambda labels: ()), preset="default",
        shipped=Mock(), **parts,
    )  # fmt: skip
    assert [state.record.name for state in service.all()] == ["attic", "depot"]
