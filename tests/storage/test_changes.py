"""What a store promises about changes of one view and of a map's ranking: atomic, and noticed by queries."""

from dataclasses import replace
from threading import Thread

import pytest

from schemas.errors import InvalidParameters
from schemas.records import ViewAttributes
from tests.storage.material import describe_all, enroll
from worker.storage.store import SqlStore


def test_corrections_at_the_same_time_lose_nothing(store: SqlStore) -> None:
    """Each reads what is said and writes it anew in one transaction, so none overwrites another's."""
    view = enroll(store, "gate").view
    keys = [f"key{number}" for number in range(8)]

    def say(key: str) -> None:
        store.views.change(view.id, lambda said: replace(said, metadata={**said.metadata, key: True}))

    threads = [Thread(target=say, args=(key,)) for key in keys]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert store.views.get(view.id).attributes.metadata == dict.fromkeys(keys, True)


def test_a_correction_that_is_refused_changes_nothing(store: SqlStore) -> None:
    view = enroll(store, "gate").view

    def refuse(_: ViewAttributes) -> ViewAttributes:
        raise InvalidParameters.of("place", "is too long")

    before = store.maps.revision("campus")
    with pytest.raises(InvalidParameters):
        store.views.change(view.id, refuse)
    assert (store.views.get(view.id), store.maps.revision("campus")) == (view, before)


def test_a_ranking_changes_at_once_as_a_revision_and_describes_nothing(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    before = store.maps.get("campus")

    after = store.maps.change_ranking("campus", lambda recipe: recipe.ranking.model_copy(update={"candidates": 7}))

    assert (after.ranking.candidates, after.description) == (7, before.description)
    assert after.revision > before.revision
    assert store.jobs.count_waiting(redescriptions=True) == 0
    assert store.maps.change_ranking("campus", lambda recipe: recipe.ranking) == after
