"""A map keeps the calibration that its user's labels gave, for as long as its scores mean the same."""

from collections.abc import Callable
from typing import Any

import pytest

from schemas.comparisons import Comparison
from schemas.errors import Conflict, NotFound
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import Filters
from tests.storage.conftest import Open
from tests.storage.material import NOW, RECIPE, describe_all, enroll, recipe
from worker.storage.store import SqlStore

OWN = '{"a": 1}'


@pytest.fixture
def calibrated(store: SqlStore) -> SqlStore:
    """A map with a described view and its own calibration."""
    enroll(store, "gate")
    describe_all(store)
    store.maps.set_calibration("campus", OWN, RECIPE)
    return store


def changed(**fields: Any) -> Callable[[MapRecipe], RankingConfig]:
    return lambda recipe: recipe.ranking.model_copy(update=fields)


def own(store: SqlStore) -> str | None:
    assert store.maps.get("campus").calibration == store.maps.all()[0].calibration
    return store.maps.get("campus").calibration


def test_it_is_kept_with_the_map_as_of_a_new_revision(store: SqlStore, reopen: Open) -> None:
    enroll(store, "gate")
    assert own(store) is None
    before = store.maps.revision("campus")
    record = store.maps.set_calibration("campus", OWN, RECIPE)
    assert (record.calibration, record.revision) == (OWN, before + 1)
    assert own(reopen()) == OWN


def test_the_same_one_again_gives_no_revision_and_none_returns_to_the_shipped_one(calibrated: SqlStore) -> None:
    before = calibrated.maps.revision("campus")
    assert calibrated.maps.set_calibration("campus", OWN).revision == before
    assert calibrated.maps.set_calibration("campus", None).revision == before + 1
    assert own(calibrated) is None
    assert calibrated.maps.set_calibration("campus", None).revision == before + 1
    with pytest.raises(NotFound):
        calibrated.maps.set_calibration("moon", None)


def test_it_is_dropped_with_other_scores_and_kept_with_another_precision(calibrated: SqlStore) -> None:
    calibrated.maps.change("campus", MapChanges(ranking=changed(precision=0.9)))
    assert own(calibrated) == OWN
    calibrated.maps.change("campus", MapChanges(ranking=changed(precision=0.9, candidates=7)))
    assert own(calibrated) is None


@pytest.mark.parametrize("described", [True, False])
def test_it_is_dropped_with_another_recipe(calibrated: SqlStore, described: bool) -> None:
    """Also with the same description and another ranking, where nothing is described anew."""
    ranking = RECIPE.ranking.model_copy(update={"candidates": 7})
    other = recipe("paper") if described else RECIPE.model_copy(update={"ranking": ranking})
    seq = calibrated.views.list("campus", Filters())[0][0].seq
    made = [Comparison(seq, 0.3, 0.1, (), 2, 1)]
    calibrated.comparisons.keep("campus", RECIPE, made, NOW)
    assert calibrated.comparisons.levels("campus").compared == 1

    calibrated.jobs.switch_recipe("campus", other, NOW)
    assert own(calibrated) == (OWN if described else None)  # queries use the old recipe until all is described
    describe_all(calibrated)

    assert own(calibrated) is None
    assert calibrated.comparisons.levels("campus").compared == 0


def test_one_that_was_fitted_to_other_scores_is_refused(calibrated: SqlStore) -> None:
    old = calibrated.maps.get("campus").recipe
    calibrated.maps.change("campus", MapChanges(ranking=changed(precision=0.9)))
    calibrated.maps.set_calibration("campus", '{"b": 2}', old)
    calibrated.maps.change("campus", MapChanges(ranking=changed(candidates=7)))
    with pytest.raises(Conflict, match="query the map with them again"):
        calibrated.maps.set_calibration("campus", OWN, old)
    with pytest.raises(Conflict):
        calibrated.maps.set_calibration("campus", OWN, recipe("paper"))
    assert own(calibrated) is None
