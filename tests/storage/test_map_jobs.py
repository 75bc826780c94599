"""What a store promises about jobs of whole maps: durable, with progress, cancelled cleanly, pruned after."""

import hashlib
from datetime import timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.enrolment import EnrolmentOptions
from schemas.errors import Conflict, LeaseLost, NotFound
from schemas.records import Filters, JobProgress, ViewRecord
from tests.storage.conftest import Open
from tests.storage.material import (
    NO_ATTRIBUTES,
    NOW,
    RECIPE,
    describe_all,
    enroll,
    facts,
    finish,
    give_sign,
    image,
    recipe,
)
from worker.storage.jobs import ATTEMPTS
from worker.storage.store import SqlStore

IMPORT = "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b93"
PAPER = recipe("paper")
TENSORS = b"tensors"
LEARNED = RECIPE.description.model_copy(update={"vocabulary": hashlib.sha256(TENSORS).hexdigest()})
LATER = NOW + timedelta(seconds=61)


def descriptions(store: SqlStore) -> dict[str, int]:
    """How many descriptions are kept by each recipe."""
    with store.maps._database.reading() as connection:
        rows = connection.execute(sa.text("SELECT recipe, count(*) AS views FROM descriptions GROUP BY recipe"))
        return {row.recipe: row.views for row in rows}


def campus_of_two(store: SqlStore) -> None:
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)


def test_a_recipe_job_tells_how_far_it_is_and_ends_with_the_last_view(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    assert (job.kind, job.state, job.progress, job.finished_at) == ("recipe", "running", JobProgress(0, 2), None)
    first, last = store.jobs.claim("worker", 2)
    finish(store, first)
    assert store.jobs.get(job.id).progress == JobProgress(1, 2)
    finish(store, last, LATER)
    done = store.jobs.get(job.id)
    assert (done.state, done.progress, done.finished_at) == ("done", JobProgress(2, 2), LATER)
    assert done.result == {"recipe": PAPER.description.id}


def test_a_job_that_tries_failed_views_again_ends_when_they_are_described(store: SqlStore) -> None:
    enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 1)
    store.jobs.fail(claim, "internal", "a bad day", NOW)
    job = store.jobs.switch_recipe("campus", RECIPE, NOW)
    assert job.state == "running"
    describe_all(store)
    assert store.jobs.get(job.id).state == "done"


def test_jobs_of_maps_survive_a_restart(store: SqlStore, reopen: Open) -> None:
    campus_of_two(store)
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    store.close()
    again = reopen()
    again.recover()
    assert again.jobs.get(job.id) == job
    describe_all(again)
    assert again.jobs.get(job.id).state == "done"
    assert again.maps.get("campus").description == PAPER.description


def test_a_vocabulary_is_trained_under_a_claim_and_described_by_as_one_job(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    assert (job.kind, job.state, job.progress) == ("vocabulary", "waiting", None)

    claim = store.jobs.claim_map_job("worker", NOW)

    assert claim is not None
    assert (claim.job_id, claim.map) == (job.id, "campus")
    assert store.jobs.claim_map_job("other", NOW) is None
    store.jobs.report(claim, JobProgress(1, 2))
    assert store.jobs.get(job.id).progress == JobProgress(1, 2)
    store.jobs.finish_training(claim, LEARNED, TENSORS, NOW)
    assert store.vocabularies.get(str(LEARNED.vocabulary)) == TENSORS
    assert (store.jobs.get(job.id).state, store.jobs.get(job.id).progress) == ("running", JobProgress(0, 2))
    assert store.jobs.claim_map_job("other", LATER) is None
    describe_all(store, LATER)
    done = store.jobs.get(job.id)
    assert (done.state, done.progress, done.result) == ("done", JobProgress(2, 2), {"recipe": LEARNED.id})
    assert store.maps.get("campus").description == LEARNED
    assert store.maps.get("campus").ranking == RECIPE.ranking


def test_a_worker_leaves_jobs_of_recipes_that_it_cannot_describe_by(store: SqlStore) -> None:
    campus_of_two(store)
    training = store.jobs.queue_vocabulary("campus", NOW)
    enroll(store, "elsewhere", map="other")
    describe_all(store)
    store.jobs.begin_shadow("other", PAPER, 5, NOW)
    describe_all(store)
    snapshot = store.jobs.queue_snapshot("campus", NOW)

    taken = store.jobs.claim_map_job("one", NOW, lambda recipe: False)
    assert taken is not None
    assert taken.job_id == snapshot.id, "it needs no description"
    assert store.jobs.claim_map_job("one", NOW, lambda recipe: False) is None

    shadow = store.jobs.claim_map_job("one", NOW, lambda recipe: recipe == PAPER.description)
    assert shadow is not None
    assert (shadow.kind, shadow.map) == ("shadow", "other")
    last = store.jobs.claim_map_job("two", NOW)
    assert last is not None
    assert last.job_id == training.id


def test_training_whose_worker_died_is_taken_up_by_another_thrice(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    claims = []
    for _ in range(ATTEMPTS):
        claims.append(store.jobs.claim_map_job("worker", NOW))
        assert store.workers.bury(["worker"], NOW) == 1
    assert store.jobs.claim_map_job("worker", NOW) is None
    ended = store.jobs.get(job.id)
    assert ended.failure is not None
    assert (ended.state, ended.failure[0]) == ("failed", "worker-died")
    for claim in claims:
        assert claim is not None
        with pytest.raises(LeaseLost):
            store.jobs.report(claim, JobProgress(0, 2))


def test_files_of_a_job_go_when_it_fails_because_its_workers_died(store: SqlStore, data: Path) -> None:
    """A recording has photos in it, and a snapshot may be large: neither waits for the next start."""
    campus_of_two(store)
    upload = store.uploads.receive(5)
    upload.write(b"photo")
    upload.end()
    store.uploads.keep(upload, IMPORT, {})
    store.jobs.queue_import(IMPORT, "campus", RECIPE, NOW)
    snapshot = store.jobs.queue_snapshot("campus", NOW).id
    (data / "snapshots").mkdir()
    draft = data / "snapshots" / f".writing-{snapshot}"
    draft.write_bytes(b"half")
    for _ in range(ATTEMPTS):
        assert {store.jobs.claim_map_job("worker", NOW) is None for _ in range(2)} == {False}
        assert draft.exists()
        assert (data / "imports" / IMPORT / "upload").exists()
        store.workers.bury(["worker"], NOW)
    assert [store.jobs.claim_map_job("worker", NOW) for _ in range(2)] == [None, None]

    assert [store.jobs.get(job).state for job in (IMPORT, snapshot)] == ["failed", "failed"]
    assert not draft.exists()
    assert not any((data / "imports").iterdir())


def test_a_claim_whose_worker_gives_signs_of_life_stays_its_own(store: SqlStore) -> None:
    campus_of_two(store)
    store.jobs.queue_vocabulary("campus", NOW)
    give_sign(store, "worker")
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    assert store.workers.bury([], LATER) == 0
    assert store.jobs.claim_map_job("other", LATER) is None
    store.jobs.report(claim, JobProgress(1, 2))


def test_training_put_back_begins_again_and_counts_no_attempt(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    store.jobs.release_map_job(claim)
    assert (store.jobs.get(job.id).state, store.jobs.get(job.id).attempts) == ("waiting", 0)
    assert store.jobs.claim_map_job("worker", NOW) is not None


@pytest.mark.parametrize("moment", ["waiting", "training", "describing"])
def test_a_cancelled_vocabulary_job_leaves_the_map_as_it_was(store: SqlStore, moment: str) -> None:
    campus_of_two(store)
    before = store.maps.get("campus")
    job = store.jobs.queue_vocabulary("campus", NOW)
    claim = None
    if moment != "waiting":
        claim = store.jobs.claim_map_job("worker", NOW)
        assert claim is not None
    if moment == "describing":
        assert claim is not None
        store.jobs.finish_training(claim, LEARNED, TENSORS, NOW)

    cancelled = store.jobs.cancel(job.id, NOW)

    assert (cancelled.state, cancelled.finished_at) == ("cancelled", NOW)
    assert store.jobs.count_waiting(redescriptions=True) == 0
    if claim is not None:
        with pytest.raises(LeaseLost):
            store.jobs.report(claim, JobProgress(1, 2))
        store.jobs.fail_map_job(claim, "internal", "it broke after all", LATER)
        assert store.jobs.get(job.id) == cancelled
    assert store.jobs.claim_map_job("worker", LATER) is None
    assert store.maps.get("campus") == before
    with pytest.raises(Conflict, match="is cancelled"):
        store.jobs.cancel(job.id, NOW)
    store.jobs.switch_recipe("campus", PAPER, NOW)  # the map is free again


def test_a_cancelled_switch_keeps_the_recipe_and_prunes_what_was_described(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    first, running = store.jobs.claim("worker", 2)
    finish(store, first)
    store.jobs.cancel(job.id, NOW)
    with pytest.raises(LeaseLost):
        finish(store, running)
    assert store.maps.get("campus").description == RECIPE.description
    assert descriptions(store) == {RECIPE.description.id: 2, PAPER.description.id: 1}
    assert store.pruning.prune() == 1
    assert descriptions(store) == {RECIPE.description.id: 2}
    assert store.pruning.prune() == 0


def test_a_map_that_was_emptied_and_given_another_recipe_is_not_trained_back_to_its_old_one(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    store.removals.delete_views("campus", Filters())

    store.maps.put("campus", PAPER, LATER)

    ended = store.jobs.get(job.id)
    assert (ended.state, ended.finished_at) == ("cancelled", LATER)
    assert ended.failure is not None
    assert "given another recipe" in ended.failure.detail
    with pytest.raises(LeaseLost):
        store.jobs.finish_training(claim, LEARNED, TENSORS, LATER)
    assert store.maps.get("campus").recipe == PAPER
    assert store.jobs.queue_vocabulary("campus", LATER).state == "waiting"


def test_the_descriptions_before_stay_for_a_way_back_and_older_ones_go(store: SqlStore) -> None:
    campus_of_two(store)
    third = recipe("third")
    store.vocabularies.keep("2" * 64, b"of nobody")
    for made in (PAPER, third):
        store.jobs.switch_recipe("campus", made, NOW)
        describe_all(store)
    while store.pruning.prune():
        pass
    assert descriptions(store) == {PAPER.description.id: 2, third.description.id: 2}
    with pytest.raises(NotFound):
        store.vocabularies.get("2" * 64)
    back = store.jobs.switch_recipe("campus", PAPER, NOW)
    assert (back.state, back.progress) == ("done", JobProgress(0, 0))


def test_what_a_deleted_map_learned_goes_and_what_another_one_uses_stays(store: SqlStore) -> None:
    """A vocabulary is made of a map's images: a deletion is complete without it."""
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    store.jobs.finish_training(claim, LEARNED, TENSORS, NOW)
    describe_all(store)
    assert store.jobs.get(job.id).state == "done"
    enroll(store, "gate", map="museum", by=PAPER)
    assert store.pruning.prune() == 0
    assert store.vocabularies.get(LEARNED.vocabulary) == TENSORS

    store.removals.delete_map("campus")
    assert store.pruning.prune() == 0

    with pytest.raises(NotFound):
        store.vocabularies.get(LEARNED.vocabulary)
    assert store.maps.labels(LEARNED.id) == ()
    assert store.maps.description(PAPER.description.id) == PAPER.description


def test_jobs_are_listed_newest_first_by_map_kind_and_state(store: SqlStore) -> None:
    campus_of_two(store)
    enroll(store, "door", map="museum")
    job = store.jobs.switch_recipe("campus", PAPER, NOW)
    everything, following = store.jobs.list(None, limit=100)
    assert following is None
    assert [one.kind for one in everything] == ["describe", "describe", "recipe", "describe", "describe", "describe"]
    assert [one.id for one in store.jobs.list("campus", kinds=["recipe"])[0]] == [job.id]
    assert [one.map for one in store.jobs.list(None, kinds=["describe"], state="waiting")[0]] == [
        "campus", "campus", "museum",
    ]  # fmt: skip
    assert store.jobs.list("campus", kinds=("describe", "recipe"))[0] == store.jobs.list("campus")[0]
    first, cursor = store.jobs.list(None, limit=4)
    rest, end = store.jobs.list(None, limit=4, cursor=cursor)
    assert [*first, *rest] == everything
    assert end is None
    with pytest.raises(NotFound):
        store.jobs.list("nowhere")


def test_a_second_change_of_a_map_names_the_job_that_is_under_way(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    with pytest.raises(Conflict, match=job.id):
        store.jobs.queue_vocabulary("campus", NOW)
    with pytest.raises(Conflict, match=job.id):
        store.jobs.switch_recipe("campus", PAPER, NOW)


def test_jobs_go_with_their_map(store: SqlStore) -> None:
    campus_of_two(store)
    job = store.jobs.queue_vocabulary("campus", NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    store.removals.delete_map("campus")
    with pytest.raises(NotFound):
        store.jobs.get(job.id)
    with pytest.raises(LeaseLost):
        store.jobs.report(claim, JobProgress(1, 2))


def test_a_map_that_is_none_is_said_to_be_none_with_what_to_do(store: SqlStore) -> None:
    for ask in (store.maps.get, store.maps.revision, lambda name: store.jobs.queue_snapshot(name, NOW)):
        with pytest.raises(NotFound, match="no map 'moon'; GET /maps lists all there are; the first enrolment"):
            ask("moon")


def test_cancelling_what_tries_failed_views_again_leaves_what_was_enrolled(store: SqlStore) -> None:
    """Both wait for the recipe of the map: nobody cancelled the enrolments, and none may stay pending for ever."""
    failed = enroll(store, "fog").view
    [claim] = store.jobs.claim("worker", 1)
    store.jobs.fail(claim, "nothing-static", "only fog", NOW)
    enrolled = enroll(store, "gate").view
    job = store.jobs.switch_recipe("campus", RECIPE, NOW + timedelta(seconds=1))
    imported = enroll(store, "yard", now=NOW + timedelta(seconds=2)).view
    assert [view.state for view in listed(store)] == ["pending"] * 3

    assert store.jobs.cancel(job.id, NOW).state == "cancelled"

    states = {view.id: (view.state, view.failure and view.failure[0]) for view in listed(store)}
    assert states == {
        failed.id: ("failed", "cancelled"),
        enrolled.id: ("pending", None),
        imported.id: ("pending", None),
    }
    assert describe_all(store) == 2
    assert enroll(store, "fog").view.state == "pending"
    assert describe_all(store) == 1
    assert {view.state for view in listed(store)} == {"ready"}


def test_a_view_is_that_of_an_import_by_who_enrolled_it_first(store: SqlStore) -> None:
    """Whatever describes it later: a recipe switch is in the background as well."""
    ours, body = enroll(store, "gate").view, image("pond")
    options = EnrolmentOptions(NOW, background=True)
    theirs = store.enrolment.submit("campus", body, facts(body), NO_ATTRIBUTES, options).view
    enroll(store, "pond")
    describe_all(store)
    store.jobs.switch_recipe("campus", PAPER, NOW)
    assert [store.jobs.is_imported(view.id) for view in (ours, theirs)] == [False, True]
    store.removals.delete_view(theirs.id)
    assert not store.jobs.is_imported(theirs.id)


def listed(store: SqlStore) -> list[ViewRecord]:
    return store.views.list("campus", Filters())[0]


@pytest.mark.parametrize("ended", ["cancelled", "deleted with its map"])
def test_an_import_that_has_ended_enrols_nothing_into_a_map_of_that_name(
    store: SqlStore, data: Path, ended: str
) -> None:
    """The worker learns of it only when it tells of its progress the next time."""
    job = store.jobs.queue_import(IMPORT, "campus", RECIPE, NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    body = image("gate")
    told = facts(body), NO_ATTRIBUTES, EnrolmentOptions(NOW, job=claim)
    store.enrolment.submit("campus", image("pond"), facts(image("pond")), *told[1:])
    if ended == "cancelled":
        store.jobs.cancel(job.id, NOW)
    else:
        store.removals.delete_map("campus")
        store.maps.put("campus", RECIPE, NOW)
    with pytest.raises(LeaseLost):
        store.enrolment.submit("campus", body, *told)
    assert [view.image.sha256 for view in listed(store)] == [facts(image("pond")).sha256] * (ended == "cancelled")
    assert not [*data.glob(f"pictures/*/*/{told[0].sha256}")]
