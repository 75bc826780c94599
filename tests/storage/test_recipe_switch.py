"""What a store promises while a map's views are described anew: no answer mixes two recipes."""

from typing import Any

import pytest
import sqlalchemy as sa

from schemas.enrolment import EnrolmentOptions
from schemas.errors import Conflict, InvalidParameters, LeaseLost, RecipeChanged
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import Filters, JobRecord
from tests.storage.material import (
    NO_ATTRIBUTES,
    NOW,
    RECIPE,
    Follower,
    describe_all,
    enroll,
    facts,
    finish,
    image,
    recipe,
    vector,
)  # fmt: skip
from worker.storage import rows, sealing
from worker.storage.store import SqlStore
from worker.storage.tables import JOBS

PAPER = recipe("paper")
PRESETS = {r.description.id: r.ranking.preset for r in (RECIPE, PAPER)}


def queued(job: JobRecord) -> int:
    """How many views a job has to describe."""
    assert job.progress is not None
    return job.progress.total


def recipe_of(store: SqlStore) -> str:
    return store.maps.get("campus").ranking.preset


def test_the_old_recipe_is_searched_until_the_last_view_is_described_by_the_new_one(store: SqlStore) -> None:
    views = [enroll(store, name).view for name in ("gate", "pond", "stairs")]
    describe_all(store)
    follower = Follower(store).catch_up()
    before = dict(follower.vectors)

    assert queued(store.jobs.switch_recipe("campus", PAPER, NOW)) == 3

    assert (store.jobs.count_waiting(), store.jobs.count_waiting(redescriptions=True)) == (0, 3)
    claims = store.jobs.claim("worker", 3)
    for claim in claims[:2]:
        assert claim.recipe == PAPER.description
        finish(store, claim)
        assert recipe_of(store) == "default"
        assert follower.catch_up().vectors == before
    revision = finish(store, claims[2])

    assert recipe_of(store) == "paper"
    assert revision == store.maps.revision("campus") > follower.revision
    assert follower.catch_up().vectors == {view.seq: vector(view, PAPER.description.id) for view in views}
    described = store.views.get(views[0].id).description
    assert described is not None
    assert described.recipe == PAPER.description.id


def test_a_switch_that_a_build_without_jobs_of_maps_began_ends(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    with store.maps._database.writing() as connection:
        connection.execute(sa.delete(JOBS).where(JOBS.c.id == job.id))

    describe_all(store)

    assert recipe_of(store) == "paper"


def test_a_roll_back_uses_the_descriptions_that_are_there(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    old = Follower(store).catch_up()
    before = dict(old.vectors)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    describe_all(store)
    new = Follower(store).catch_up()

    assert queued(store.jobs.switch_recipe("campus", RECIPE, NOW)) == 0

    assert recipe_of(store) == "default"
    assert old.catch_up().vectors == new.catch_up().vectors == before


def test_an_index_that_slept_through_a_switch_and_back_forgets_what_was_deleted_meanwhile(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    enroll(store, "pond")
    describe_all(store)
    follower = Follower(store).catch_up()
    store.jobs.switch_recipe("campus", PAPER, NOW)
    describe_all(store)
    store.removals.delete_view(view.id)
    store.jobs.switch_recipe("campus", RECIPE, NOW)
    assert follower.catch_up().vectors == Follower(store).catch_up().vectors
    assert view.seq not in follower.vectors


def test_a_second_switch_waits_for_the_first(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    with pytest.raises(Conflict, match="by the recipe job"):
        store.jobs.switch_recipe("campus", recipe("third"), NOW)


def test_an_image_enrolled_during_a_switch_is_described_by_both_recipes_and_goes_first(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    view = enroll(store, "pond").view

    claims = store.jobs.claim("worker", 5)

    assert [(claim.view.id == view.id, PRESETS[claim.recipe.id]) for claim in claims] == [
        (True, "default"),
        (False, "paper"),
        (True, "paper"),
    ]
    finish(store, claims[0])
    assert store.views.get(view.id).state == "ready"
    assert recipe_of(store) == "default"
    finish(store, claims[1])
    assert recipe_of(store) == "default"
    finish(store, claims[2])
    assert recipe_of(store) == "paper"


def test_a_view_that_the_new_recipe_cannot_describe_fails_when_the_map_changes_over(store: SqlStore) -> None:
    gate, pond = (enroll(store, name).view for name in ("gate", "pond"))
    describe_all(store)
    follower = Follower(store).catch_up()
    store.jobs.switch_recipe("campus", PAPER, NOW)
    first, last = store.jobs.claim("worker", 2)
    store.jobs.fail(first, "nothing-static", "only cars", NOW)
    assert store.views.get(gate.id).state == "ready"

    finish(store, last)

    assert store.views.get(gate.id).failure == ("nothing-static", "only cars")
    assert follower.catch_up().vectors.keys() == {pond.seq}
    assert queued(store.jobs.switch_recipe("campus", RECIPE, NOW)) == 0
    assert (store.views.get(gate.id).state, store.views.get(gate.id).failure) == ("ready", None)
    assert follower.catch_up().vectors.keys() == {gate.seq, pond.seq}


def test_switching_to_the_recipe_in_use_tries_again_what_failed(store: SqlStore) -> None:
    gate, pond = (enroll(store, name).view for name in ("gate", "pond"))
    first, last = store.jobs.claim("worker", 2)
    store.jobs.fail(first, "nothing-static", "only cars", NOW)
    finish(store, last)

    assert queued(store.jobs.switch_recipe("campus", RECIPE, NOW)) == 1

    assert (store.views.get(gate.id).state, store.views.get(gate.id).failure) == ("pending", None)
    describe_all(store)
    assert [store.views.get(view.id).state for view in (gate, pond)] == ["ready", "ready"]


@pytest.mark.parametrize("settle", ["delete", "delete by filter", "cancel"])
def test_a_switch_ends_when_the_last_view_it_waits_for_needs_no_description(store: SqlStore, settle: str) -> None:
    gate, pond = (enroll(store, name).view for name in ("gate", "pond"))
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    [claim] = store.jobs.claim("worker", 1)
    finish(store, claim)
    if settle == "delete":
        store.removals.delete_view(pond.id)
    elif settle == "delete by filter":
        store.removals.delete_views("campus", Filters(exclude=(gate.id,)))
    else:
        [other] = store.jobs.claim("worker", 1)
        store.jobs.release(other)
        store.jobs.cancel(other.job_id, NOW)
    assert recipe_of(store) == "paper"
    assert Follower(store).catch_up().vectors.keys() == {gate.seq}


def test_an_image_still_waiting_for_the_old_recipe_is_ready_by_the_new_one(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    store.jobs.switch_recipe("campus", PAPER, NOW)
    old, new = store.jobs.claim("worker", 2)
    finish(store, new)
    assert (recipe_of(store), store.views.get(view.id).state) == ("paper", "ready")
    before = store.maps.revision("campus")
    finish(store, old)
    assert store.maps.revision("campus") == before
    assert queued(store.jobs.switch_recipe("campus", RECIPE, NOW)) == 0


def test_a_map_without_views_changes_over_at_once(store: SqlStore) -> None:
    store.maps.put("campus", RECIPE, NOW)
    assert queued(store.jobs.switch_recipe("campus", PAPER, NOW)) == 0
    assert recipe_of(store) == "paper"


def test_a_ranking_changed_during_a_switch_is_changed_in_both_and_neither_gets_the_rest_of_the_other(
    store: SqlStore,
) -> None:
    enroll(store, "gate")
    describe_all(store)
    following = MapRecipe(
        description=PAPER.description, ranking=PAPER.ranking.model_copy(update={"candidates": 33, "mode": "graph"})
    )
    store.jobs.switch_recipe("campus", following, NOW)

    now = store.maps.change("campus", MapChanges(ranking=lambda of: of.ranking.model_copy(update={"precision": 0.9})))

    assert now.ranking == RECIPE.ranking.model_copy(update={"precision": 0.9})
    describe_all(store)
    after = store.maps.get("campus")
    assert after.recipe == MapRecipe(
        description=PAPER.description, ranking=following.ranking.model_copy(update={"precision": 0.9})
    )


def test_a_ranking_that_the_next_recipe_does_not_allow_is_refused_until_the_map_has_it(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    before = store.maps.get("campus")

    def change(of: MapRecipe) -> RankingConfig:
        if of.description == PAPER.description:
            raise InvalidParameters.of("ranking.candidates", "is too large")
        return of.ranking.model_copy(update={"candidates": 7})

    with pytest.raises(Conflict, match=r"changing over to the recipe \w+, which.*ranking\.candidates: is too large"):
        store.maps.change("campus", MapChanges(ranking=change))
    assert store.maps.get("campus") == before


@pytest.mark.parametrize("begin", ["switch", "shadow"])
def test_a_recipe_made_from_another_than_the_map_has_by_now_is_refused(store: SqlStore, begin: str) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.maps.change("campus", MapChanges(ranking=lambda of: of.ranking.model_copy(update={"candidates": 7})))
    present = store.maps.get("campus").recipe

    def start(made_from: MapRecipe) -> JobRecord:
        if begin == "shadow":
            return store.jobs.begin_shadow("campus", PAPER, 5, NOW, made_from)
        return store.jobs.switch_recipe("campus", PAPER, NOW, made_from)

    for outdated in (RECIPE, MapRecipe(description=PAPER.description, ranking=present.ranking)):
        with pytest.raises(RecipeChanged):
            start(outdated)
    assert store.jobs.count_waiting(redescriptions=True) == 0
    assert start(present).kind in ("recipe", "shadow")


@pytest.mark.parametrize("shadow", [False, True], ids=["switch", "shadow"])
@pytest.mark.parametrize("first", ["refused", "by the next recipe", "the change of recipe"])
def test_a_view_that_is_refused_as_poor_is_described_by_no_recipe(store: SqlStore, first: str, shadow: bool) -> None:
    gate = enroll(store, "gate").view
    describe_all(store)
    if shadow:
        store.jobs.begin_shadow("campus", PAPER, 5, NOW)
    else:
        store.jobs.switch_recipe("campus", PAPER, NOW)
    body = image("fog")
    fog = store.enrolment.submit(
        "campus", body, facts(body), NO_ATTRIBUTES, EnrolmentOptions(NOW, RECIPE, background=True, refuse_poor=True)
    ).view
    claims = {(claim.view.id, claim.recipe == PAPER.description): claim for claim in store.jobs.claim("worker", 9)}
    if first == "by the next recipe":
        finish(store, claims[fog.id, True])
    elif first == "the change of recipe":
        finish(store, claims[fog.id, True])
        finish(store, claims[gate.id, True])
    follower, known = Follower(store).catch_up(), store.descriptions.since("campus", 0, PAPER.description)

    store.jobs.fail(claims[fog.id, False], "poor-picture", "it shows mostly what moves", NOW)

    if first == "refused":
        with pytest.raises(LeaseLost):
            finish(store, claims[fog.id, True])
    assert list(follower.catch_up().vectors) == [gate.seq]
    later = store.descriptions.since("campus", known.revision, PAPER.description)
    assert set(known.seqs.tolist()) - set(later.gone.tolist()) <= {gate.seq}
    if first != "the change of recipe":
        finish(store, claims[gate.id, True])
    if shadow:
        claim = store.jobs.claim_map_job("worker", NOW)
        assert claim is not None
        store.jobs.finish_shadow(claim, {"wanted": 5, "queries": []}, NOW)
        store.jobs.switch_to_shadow("campus", NOW)
    assert recipe_of(store) == "paper"
    refused = store.views.get(fog.id)
    assert (refused.state, refused.failure) == ("failed", ("poor-picture", "it shows mostly what moves"))
    assert list(Follower(store).catch_up().vectors) == list(follower.catch_up().vectors) == [gate.seq]
    assert enroll(store, "fog").view.id == fog.id  # sent again, it is judged again
    describe_all(store)
    assert list(follower.catch_up().vectors) == [gate.seq, fog.seq]


def test_a_map_changes_over_without_writing_views_that_stay_as_they_are(store: SqlStore) -> None:
    """PostgreSQL would write each of them anew, with all index entries, while nobody else may write."""
    for number in range(12):
        enroll(store, f"view {number}")
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    *first, last = store.jobs.claim("worker", 12)
    for claim in first:
        finish(store, claim)
    written: list[int] = []

    def count(*of: Any) -> None:
        if of[2].startswith("UPDATE views"):
            written.append(of[1].rowcount)

    sa.event.listen(store._database.engine, "after_cursor_execute", count)
    finish(store, last)
    assert (recipe_of(store), sum(written)) == ("paper", 0)
    assert {view.state for view in store.views.list("campus", Filters())[0]} == {"ready"}


def test_the_jobs_of_a_large_map_are_written_and_sealed_in_portions(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A transaction that writes a row for each view does not hold them all in memory."""
    for number in range(10):
        enroll(store, f"view {number}")
    describe_all(store)
    together: list[int] = []

    def count(*of: Any) -> None:
        together.append(len(of[3]) if of[5] else 1)

    monkeypatch.setattr(rows, "BATCH", 4)
    monkeypatch.setattr(sealing, "PORTION", 5)
    sa.event.listen(store._database.engine, "before_cursor_execute", count)
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    store.jobs.cancel(job.id, NOW)
    assert max(together) == 5
    with store._database.reading() as connection:
        assert connection.scalar(sa.select(sa.func.count()).where(JOBS.c.checksum.is_(None))) == 0
    described = store.jobs.list("campus", kinds=["describe"])[0]
    assert [one.state for one in described] == ["cancelled"] * 10 + ["done"] * 10
