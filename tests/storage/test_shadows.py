"""What a store promises of a shadow: a recipe beside that of a map, until the map is told what to do."""

from collections.abc import Callable
from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.comparisons import Comparison
from schemas.errors import Conflict, LeaseLost, NotFound
from schemas.map_changes import MapChanges
from schemas.records import Filters, JobProgress, MapClaim
from tests.storage.carried import made
from tests.storage.conftest import Open
from tests.storage.material import (
    NOW,
    RECIPE,
    Follower,
    describe_all,
    enroll,
    finish,
    give_sign,
    recipe,
    vector,
)  # fmt: skip
from worker.storage.examining import examine
from worker.storage.repairing import repair
from worker.storage.store import SqlStore
from worker.storage.tables import JOBS

PAPER = recipe("paper")
ROW = {"id": "query", "old": {"view": None}, "new": {"view": None}}


def begin(store: SqlStore) -> str:
    """Begin a shadow of the map ``campus``; returns the id of its job."""
    return store.jobs.begin_shadow("campus", PAPER, 7, NOW).id


def described(store: SqlStore) -> str:
    """A map of two views with a shadow that describes them."""
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)
    job = begin(store)
    describe_all(store)
    return job


def claimed(store: SqlStore, worker: str = "worker") -> MapClaim:
    give_sign(store, worker)
    claim = store.jobs.claim_map_job(worker, NOW)
    assert claim is not None
    assert claim.kind == "shadow"
    return claim


def made_ready(store: SqlStore) -> str:
    job = described(store)
    store.jobs.finish_shadow(claimed(store), {"wanted": 7, "queries": [ROW]}, NOW)
    return job


def recipe_of(store: SqlStore) -> str:
    return store.maps.get("campus").ranking.preset


def test_the_map_is_searched_as_before_until_it_is_told(store: SqlStore) -> None:
    views = [enroll(store, name).view for name in ("gate", "pond")]
    describe_all(store)
    follower = Follower(store).catch_up()
    before, revision = dict(follower.vectors), store.maps.revision("campus")
    begin(store)
    states = [store.jobs.shadow("campus").state]
    assert store.jobs.claim_map_job("worker", NOW) is None
    assert store.jobs.get(store.jobs.shadow("campus").job.id).progress == JobProgress(0, 2)
    describe_all(store)
    states.append(store.jobs.shadow("campus").state)
    claim = claimed(store)
    store.jobs.report(claim, JobProgress(1, 5))
    assert store.jobs.get(claim.job_id).progress == JobProgress(1, 5)
    states.append(store.jobs.shadow("campus").state)
    store.jobs.finish_shadow(claim, {"wanted": 7, "queries": [ROW]}, NOW)
    shadow = store.jobs.shadow("campus")

    assert [*states, shadow.state] == ["describing", "comparing", "comparing", "ready"]
    assert (shadow.wanted, shadow.recipe, shadow.job.state) == (7, PAPER, "done")
    assert (recipe_of(store), store.maps.revision("campus")) == ("default", revision)
    assert follower.catch_up().vectors == before

    job = store.jobs.switch_to_shadow("campus", NOW)

    assert (job.kind, job.state) == ("recipe", "done")
    assert recipe_of(store) == "paper"
    assert follower.catch_up().vectors == {view.seq: vector(view, PAPER.description.id) for view in views}
    assert store.jobs.get(shadow.job.id).result == {"wanted": 7, "queries": []}
    assert store.jobs.switch_recipe("campus", RECIPE, NOW).progress == JobProgress(0, 0)
    assert follower.catch_up().vectors == before


def test_it_is_switched_to_when_it_is_ready_and_not_before(store: SqlStore) -> None:
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)
    with pytest.raises(NotFound, match="shadow"):
        store.jobs.switch_to_shadow("campus", NOW)
    begin(store)
    with pytest.raises(Conflict, match="is describing"):
        store.jobs.switch_to_shadow("campus", NOW)
    describe_all(store)
    with pytest.raises(Conflict, match="is comparing"):
        store.jobs.switch_to_shadow("campus", NOW)
    claimed(store)
    with pytest.raises(Conflict, match="is comparing"):
        store.jobs.switch_to_shadow("campus", NOW)
    assert recipe_of(store) == "default"


def test_one_at_a_time_and_of_another_recipe(store: SqlStore) -> None:
    made_ready(store)
    for again in (
        lambda: begin(store),
        lambda: store.jobs.switch_recipe("campus", PAPER, NOW),
        lambda: store.jobs.queue_vocabulary("campus", NOW),
        lambda: store.maps.change("campus", MapChanges(keep_images=False)),
    ):
        with pytest.raises(Conflict, match="/maps/campus/shadow"):
            again()
    store.jobs.discard_shadow("campus", NOW)
    with pytest.raises(Conflict, match="by this recipe already"):
        store.jobs.begin_shadow("campus", RECIPE, 7, NOW)


@pytest.mark.parametrize("when", ["describing", "described", "claimed", "ready"])
def test_a_discarded_shadow_leaves_nothing(store: SqlStore, when: str) -> None:
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)
    follower = Follower(store).catch_up()
    before = dict(follower.vectors)
    job = begin(store)
    if when != "describing":
        describe_all(store)
    claim = claimed(store) if when in ("claimed", "ready") else None
    if when == "ready" and claim is not None:
        store.jobs.finish_shadow(claim, {"wanted": 7}, NOW)
    assert store.pruning.prune() == 0

    store.jobs.discard_shadow("campus", NOW)

    assert store.jobs.get(job).state == ("done" if when == "ready" else "cancelled")
    with pytest.raises(NotFound):
        store.jobs.discard_shadow("campus", NOW)
    if when == "claimed" and claim is not None:
        with pytest.raises(LeaseLost):
            store.jobs.finish_shadow(claim, {}, NOW)
    assert store.jobs.count_waiting(redescriptions=True) == 0
    while store.pruning.prune():
        pass
    assert len(store.descriptions.described("campus", PAPER.description.id)) == 0
    assert follower.catch_up().vectors == before
    assert store.jobs.begin_shadow("campus", recipe("third"), 7, NOW).state == "running"


def test_cancelling_its_job_discards_it(store: SqlStore) -> None:
    store.jobs.cancel(described(store), NOW)
    with pytest.raises(NotFound):
        store.jobs.shadow("campus")


def test_views_that_are_enrolled_and_deleted_meanwhile_are_right_by_both(store: SqlStore) -> None:
    made_ready(store)
    late = enroll(store, "late").view
    old, new = store.jobs.claim("worker", 5)
    assert [old.recipe, new.recipe] == [RECIPE.description, PAPER.description]
    finish(store, old)
    assert store.views.get(late.id).state == "ready"

    job = store.jobs.switch_to_shadow("campus", NOW)
    assert (job.state, recipe_of(store)) == ("running", "default")
    finish(store, new)

    assert (store.jobs.get(job.id).state, recipe_of(store)) == ("done", "paper")
    assert late.seq in Follower(store).catch_up().vectors


def test_the_rows_of_a_deleted_view_leave_the_table(store: SqlStore) -> None:
    described(store)
    gate, pond = store.views.at(list(Follower(store).catch_up().vectors)).values()
    rows = [{"id": id, "source": source, "old": {"view": old}, "new": {"view": new}} for id, source, old, new in (
        (gate.id, "view", pond.id, None), ("one", "kept", pond.id, gate.id), ("other", "kept", pond.id, pond.id),
    )]  # fmt: skip
    store.jobs.finish_shadow(claimed(store), {"wanted": 7, "totals": 3, "queries": rows}, NOW)

    store.removals.delete_view(gate.id)

    assert store.jobs.shadow("campus").job.result == {"wanted": 7, "totals": 3, "queries": rows[2:]}


def test_the_rows_of_a_view_that_is_deleted_while_answers_are_compared_enter_no_table(store: SqlStore) -> None:
    described(store)
    gate, pond = store.views.at(list(Follower(store).catch_up().vectors)).values()
    rows = [
        {"id": id, "source": source, "old": {"view": old}, "new": {"view": new}} for id, source, old, new in (
            (gate.id, "view", pond.id, None), ("first", "kept", pond.id, gate.id), ("second", "kept", pond.id, None),
            (pond.id, "view", None, None), ("third", "kept", gate.id, pond.id),
        )
    ]  # fmt: skip
    claim = claimed(store)
    store.removals.delete_view(gate.id)

    store.jobs.finish_shadow(claim, {"wanted": 7, "totals": 5, "queries": rows}, NOW)

    assert store.jobs.shadow("campus").job.result == {"wanted": 7, "totals": 5, "queries": rows[2:4]}


def test_a_worker_that_dies_comparing_leaves_the_job_to_the_next(store: SqlStore) -> None:
    described(store)
    claim = claimed(store, "first")

    store.workers.bury(["first"], NOW)

    with pytest.raises(LeaseLost):
        store.jobs.finish_shadow(claim, {}, NOW)
    store.jobs.finish_shadow(claimed(store, "second"), {"wanted": 7}, NOW)
    assert store.jobs.shadow("campus").state == "ready"


@pytest.mark.parametrize("how", ["error", "deaths"])
def test_a_shadow_whose_comparison_fails_is_gone_with_the_reason(store: SqlStore, how: str) -> None:
    job = described(store)
    if how == "error":
        store.jobs.fail_map_job(claimed(store), "internal", "broken", NOW)
    else:
        for number in range(3):
            claimed(store, f"worker {number}")
            store.workers.bury([f"worker {number}"], NOW)
        assert store.jobs.claim_map_job("worker", NOW) is None
    record = store.jobs.get(job)
    assert (record.state, record.failure and record.failure[0]) == (
        "failed", "internal" if how == "error" else "worker-died",
    )  # fmt: skip
    with pytest.raises(NotFound):
        store.jobs.shadow("campus")
    assert recipe_of(store) == "default"


@pytest.mark.parametrize("when", [begin, made_ready])
def test_it_is_alive_after_a_restart(reopen: Open, when: Callable[[SqlStore], str]) -> None:
    store = reopen()
    if when is begin:
        enroll(store, "gate")
        describe_all(store)
    job = when(store)
    state = store.jobs.shadow("campus")
    store.close()

    again = reopen()

    assert again.jobs.shadow("campus") == state
    if when is begin:
        describe_all(again)
        again.jobs.finish_shadow(claimed(again), {"wanted": 7}, NOW)
    assert again.jobs.shadow("campus").job.id == job
    assert again.jobs.switch_to_shadow("campus", NOW).state == "done"


def test_a_snapshot_meanwhile_is_of_the_map_without_its_shadow(store: SqlStore) -> None:
    made_ready(store)

    store.restoring.restore(made(store), "copy", NOW)

    with pytest.raises(NotFound):
        store.jobs.shadow("copy")
    assert store.maps.get("copy").description == RECIPE.description
    assert len(store.descriptions.described("copy", PAPER.description.id)) == 0
    assert store.jobs.shadow("campus").state == "ready"


def test_a_changed_precision_is_that_of_the_shadow_too(store: SqlStore) -> None:
    """It changes no score that the shadow is compared by, and the switch must not undo it."""
    made_ready(store)
    present = store.maps.get("campus").ranking
    for changes in ({"precision": 0.99, "candidates": 3}, {"candidates": present.candidates}):
        store.maps.change("campus", MapChanges(ranking=lambda of, to=changes: of.ranking.model_copy(update=to)))  # type: ignore[misc]
    store.jobs.switch_to_shadow("campus", NOW)
    assert store.maps.get("campus").ranking == PAPER.ranking.model_copy(update={"precision": 0.99})


def test_a_ranking_that_the_map_has_already_changes_no_shadow(store: SqlStore) -> None:
    made_ready(store)
    present = store.maps.get("campus").ranking
    assert present != PAPER.ranking
    store.maps.change("campus", MapChanges(ranking=lambda _: present))
    assert store.jobs.shadow("campus").recipe == PAPER


def test_a_changed_ranking_is_that_of_the_map_alone(store: SqlStore) -> None:
    made_ready(store)
    store.maps.change("campus", MapChanges(ranking=lambda recipe: recipe.ranking.model_copy(update={"candidates": 3})))
    assert store.jobs.shadow("campus").recipe == PAPER
    store.jobs.switch_to_shadow("campus", NOW)
    assert store.maps.get("campus").ranking == PAPER.ranking


def test_its_comparisons_change_no_answer_before_the_switch(store: SqlStore) -> None:
    described(store)
    seqs = [int(seq) for seq in store.descriptions.described("campus", PAPER.description.id)]
    levels, revision = store.comparisons.levels("campus"), store.maps.revision("campus")

    by = PAPER.description.id
    store.comparisons.keep("campus", PAPER, [Comparison(seq, 0.5, 0.1, (), 2, 1, None, None) for seq in seqs], NOW)

    assert store.maps.revision("campus") == revision
    assert store.comparisons.levels("campus") == levels
    assert (store.comparisons.levels("campus", by).compared, store.comparisons.levels("campus", by).level) == (2, 0.5)


def test_an_emptied_map_that_is_put_anew_has_no_shadow(store: SqlStore) -> None:
    store.maps.put("campus", RECIPE, NOW)
    job = begin(store)
    store.maps.put("campus", recipe("third"), NOW)
    assert store.jobs.get(job).state == "cancelled"
    with pytest.raises(NotFound):
        store.jobs.shadow("campus")
    assert recipe_of(store) == "third"


def test_a_map_that_is_emptied_and_put_anew_drops_the_table_of_its_shadow(store: SqlStore) -> None:
    job = made_ready(store)
    store.removals.delete_views("campus", Filters())
    store.maps.put("campus", recipe("third"), NOW)
    result = store.jobs.get(job).result
    assert (result and result["wanted"], result and result["queries"]) == (7, [])


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_doctor_discards_a_shadow_whose_job_is_lost(reopen: Open, database_url: str, data: Path, damage: str) -> None:
    store = reopen()
    job = made_ready(store)
    with store.maps._database.engine.begin() as connection:
        if damage == "gone":
            connection.execute(sa.delete(JOBS).where(JOBS.c.id == job))
        else:
            broken = {"result": "{}", "checksum": JOBS.c.checksum}
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job).values(**broken))
    store.close()

    assert "its shadow has no job" in [finding.what for finding in examine(database_url, data)]
    _, left = repair(database_url, data)

    assert left == []
    store = reopen()
    with pytest.raises(NotFound):
        store.jobs.shadow("campus")
    assert recipe_of(store) == "default"


def test_doctor_has_nothing_to_say_of_a_shadow(reopen: Open, database_url: str, data: Path) -> None:
    store = reopen()
    made_ready(store)
    store.close()
    assert list(examine(database_url, data)) == []
