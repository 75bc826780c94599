"""A process holds no index of a map that another one deleted: nobody tells it."""

import pytest

from schemas.errors import NotFound
from tests.storage.material import NOW, describe_all, enroll, recipe
from worker.search.catalogue import Catalogue
from worker.search.flat_index import FlatIndex
from worker.storage.store import SqlStore


def test_the_index_of_a_map_that_was_deleted_elsewhere_is_dropped_with_the_next_map(store: SqlStore) -> None:
    here = Catalogue(store.maps, store.descriptions, FlatIndex.of)
    for number in range(5):
        for name in ("stays", f"run {number}"):
            enroll(store, "gate", map=name)
            describe_all(store)
            assert len(here.index(name)[0]) == 1
        store.removals.delete_map(f"run {number}")
    assert set(here.revisions()) == {"stays", "run 4"}

    with pytest.raises(NotFound):
        here.index("run 4")
    enroll(store, "gate", map="run 4")
    describe_all(store)
    index, record = here.index("run 4")
    assert (len(index), record.revision) == (1, index.revision)


def test_what_was_read_ahead_of_a_deleted_map_is_dropped_too(store: SqlStore) -> None:
    here = Catalogue(store.maps, store.descriptions, FlatIndex.of)
    enroll(store, "gate")
    describe_all(store)
    store.jobs.switch_recipe("campus", recipe("paper"), NOW)
    here.prepare("campus", recipe("paper").description)
    store.removals.delete_map("campus")

    enroll(store, "gate", map="another")
    here.index("another")
    assert here._prepared == {}
