"""What a store promises about changes of one view and of a map's settings: atomic, and noticed by queries."""

from dataclasses import replace
from threading import Thread

import pytest

from schemas.errors import Conflict, InvalidParameters
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import ViewAttributes
from tests.storage.material import NOW, describe_all, enroll
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

    after = store.maps.change("campus", MapChanges(ranking=seven_candidates))

    assert (after.ranking.candidates, after.description) == (7, before.description)
    assert after.revision > before.revision
    assert store.jobs.count_waiting(redescriptions=True) == 0
    assert store.maps.change("campus", MapChanges(ranking=lambda recipe: recipe.ranking)) == after


def seven_candidates(recipe: MapRecipe) -> RankingConfig:
    return recipe.ranking.model_copy(update={"candidates": 7})


def refused(recipe: MapRecipe) -> RankingConfig:
    raise InvalidParameters.of("ranking.candidates", "is too large")


def test_several_settings_change_together(store: SqlStore) -> None:
    enroll(store, "gate")
    changes = MapChanges(
        ranking=seven_candidates, blur=(), keep_images=False, keep_queries=3, keep_matches=4, refuse_poor=True
    )
    after = store.maps.change("campus", changes)
    assert after == store.maps.get("campus")
    assert (after.ranking.candidates, after.keep_images, after.refuse_poor) == (7, False, True)
    assert (after.keep_queries, after.keep_matches) == (3, 4)


@pytest.mark.parametrize(
    "last",
    [
        MapChanges(ranking=refused, refuse_poor=True),
        MapChanges(ranking=seven_candidates, keep_matches=4, refuse_poor=True, blur=("people",)),
        MapChanges(ranking=seven_candidates, keep_queries=3, refuse_poor=True, keep_images=False),
    ],
    ids=["a ranking that is refused", "words that were seen", "images that are read"],
)
def test_settings_beside_one_that_is_refused_stay_as_they_were(store: SqlStore, last: MapChanges) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.jobs.queue_vocabulary("campus", NOW)
    before = store.maps.get("campus")
    with pytest.raises((Conflict, InvalidParameters)):
        store.maps.change("campus", last)
    assert store.maps.get("campus") == before
