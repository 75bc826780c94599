"""What a store promises about work: claims, tries, and several workers."""

from datetime import timedelta
from multiprocessing import get_context
from pathlib import Path
from threading import Thread

import pytest
import sqlalchemy as sa

from schemas.enrolment import EnrolmentOptions
from schemas.errors import Conflict, LeaseLost, NotFound
from schemas.recipe import DescriptionRecipe
from schemas.records import Filters, ViewRecord
from tests.storage.conftest import Open
from tests.storage.material import (
    NO_ATTRIBUTES,
    NOW,
    RECIPE,
    Follower,
    describe_all,
    enroll,
    facts,
    finish,
    give_sign,
    image,
    recipe,
)
from worker.storage.store import SqlStore, open_store
from worker.storage.tables import RECIPES


def test_the_oldest_job_goes_first(store: SqlStore) -> None:
    names = ["gate", "pond", "stairs"]
    views = [enroll(store, name).view for name in names]
    assert [claim.view.id for claim in store.jobs.claim("one", 2)] == [views[0].id, views[1].id]
    assert [claim.view.id for claim in store.jobs.claim("two", 2)] == [views[2].id]
    assert store.jobs.claim("three", 2) == []
    assert store.jobs.count_waiting() == 3


def test_jobs_of_damaged_recipes_are_left_and_those_behind_them_go_on(store: SqlStore) -> None:
    for number, name in enumerate(["one", "other"]):
        damaged = recipe(name)
        for at in range(2 + number):
            enroll(store, f"{name} {at}", map=name, by=damaged)
        with store._database.writing() as connection:
            connection.execute(sa.update(RECIPES).where(RECIPES.c.id == damaged.description.id).values(body="{}"))
    views = [enroll(store, name).view for name in ("gate", "pond", "stairs")]
    assert [claim.view.id for claim in store.jobs.claim("one", 2)] == [views[0].id, views[1].id]
    assert [claim.view.id for claim in store.jobs.claim("two", 2)] == [views[2].id]
    assert store.jobs.claim("three", 2) == []
    assert store.jobs.count_waiting() == 8


def test_a_worker_leaves_what_it_cannot_describe_and_takes_what_is_behind_it(store: SqlStore) -> None:
    other = recipe("other")
    left = [enroll(store, f"other {at}", map="other", by=other).view.id for at in range(3)]
    views = [enroll(store, name).view.id for name in ("gate", "pond")]
    seen: list[str] = []

    def able(wanted: DescriptionRecipe) -> bool:
        seen.append(wanted.id)
        return wanted.id != other.description.id

    assert [claim.view.id for claim in store.jobs.claim("one", 2, able)] == views
    assert sorted(seen) == sorted({other.description.id, RECIPE.description.id}), "each recipe once"
    assert store.jobs.claim("one", 2, able) == []
    assert [claim.view.id for claim in store.jobs.claim("two", 9)] == left


def test_a_job_whose_worker_is_silent_goes_to_another_and_the_late_one_changes_nothing(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    give_sign(store, "late")
    [late] = store.jobs.claim("late", 1)
    assert store.workers.bury([], NOW) == 0
    assert store.jobs.claim("other", 1) == []
    assert store.workers.bury(["late"], NOW) == 1
    [other] = store.jobs.claim("other", 1)
    assert (other.job_id, other.attempts) == (late.job_id, 2)

    with pytest.raises(LeaseLost):
        finish(store, late)
    with pytest.raises(LeaseLost):
        store.jobs.fail(late, "undecodable-picture", "late", NOW)
    store.jobs.release(late)

    assert store.views.get(view.id).state == "pending"
    finish(store, other)
    with pytest.raises(LeaseLost):
        finish(store, other)
    assert store.views.get(view.id).state == "ready"


def test_a_job_remembers_that_poor_images_are_refused(store: SqlStore) -> None:
    for name, wanted in (("gate", False), ("pond", True)):
        body = image(name)
        store.enrolment.submit(
            "campus", body, facts(body), NO_ATTRIBUTES, EnrolmentOptions(NOW, RECIPE, refuse_poor=wanted)
        )
    give_sign(store, "dying")
    assert [claim.refuse_poor for claim in store.jobs.claim("dying", 2)] == [False, True]
    store.workers.bury(["dying"], NOW)
    pond = store.jobs.claim("heir", 2)[1]
    assert pond.refuse_poor

    store.jobs.fail(pond, "poor-picture", "it adds nothing", NOW)

    refused = store.views.get(pond.view.id)
    assert (refused.state, refused.failure) == ("failed", ("poor-picture", "it adds nothing"))
    assert Follower(store).catch_up().vectors == {}


def test_an_enrolment_that_another_call_was_told_of_is_not_taken_back(store: SqlStore) -> None:
    alone, told = enroll(store, "pond").view, enroll(store, "gate").view
    assert not enroll(store, "gate").created

    store.removals.delete_view(alone.id, undoes=True)
    with pytest.raises(Conflict, match="told of this view"):
        store.removals.delete_view(told.id, undoes=True)

    assert [view.id for view in store.views.list("campus", Filters())[0]] == [told.id]
    assert store.removals.delete_view(told.id).views == 1  # whoever asks for that gets it


def test_a_call_is_told_of_a_view_that_is_about_to_be_taken_back(store: SqlStore) -> None:
    """It failed, and the call that enrolled it has not come to remove it: whoever sends it again has it described."""
    view = enroll(store, "gate").view
    [claim] = store.jobs.claim("one", 1)
    store.jobs.fail(claim, "poor-picture", "it adds nothing", NOW)
    assert enroll(store, "gate").job_id is not None

    with pytest.raises(Conflict):
        store.removals.delete_view(view.id, undoes=True)


def test_an_enrolment_that_was_described_meanwhile_is_not_taken_back(store: SqlStore) -> None:
    """Its call was about to be answered that nothing can be stored; another one found the view described."""
    view = enroll(store, "gate").view
    describe_all(store)
    again = enroll(store, "gate")
    assert (again.created, again.view.state) == (False, "ready")

    with pytest.raises(Conflict, match="described meanwhile"):
        store.removals.delete_view(view.id, undoes=True)
    assert store.views.get(view.id).state == "ready"


def test_an_import_that_goes_on_takes_its_own_back(store: SqlStore) -> None:
    def submit(name: str, background: bool) -> ViewRecord:
        body = image(name)
        return store.enrolment.submit(
            "campus", body, facts(body), NO_ATTRIBUTES, EnrolmentOptions(NOW, RECIPE, background=background)
        ).view

    own, foreign = submit("gate", background=True), submit("pond", background=False)
    submit("gate", background=True), submit("pond", background=True)

    store.removals.delete_view(own.id, undoes=True)
    with pytest.raises(Conflict):
        store.removals.delete_view(foreign.id, undoes=True)


def test_a_worker_that_is_late_but_alone_may_still_finish(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    [claim] = store.jobs.claim("slow", 1)
    finish(store, claim, NOW + timedelta(days=5))
    assert store.views.get(view.id).state == "ready"


def test_an_image_that_kills_three_workers_is_given_up(store: SqlStore) -> None:
    submitted = enroll(store, "bomb")
    moment = NOW
    for attempt in (1, 2, 3):
        [claim] = store.jobs.claim("worker", 1)
        assert claim.attempts == attempt
        moment += timedelta(minutes=1)
        assert store.workers.bury(["worker"], moment) == 1
    assert store.jobs.claim("worker", 1) == []
    view = store.views.get(submitted.view.id)
    assert view.state == "failed"
    assert view.failure is not None
    assert view.failure[0] == "worker-died"
    assert "3 times" in view.failure[1]
    assert store.jobs.get(claim.job_id).state == "failed"
    assert store.jobs.get(claim.job_id).finished_at == moment
    assert store.jobs.count_waiting() == 0


def test_a_job_put_back_waits_unharmed(store: SqlStore) -> None:
    enroll(store, "gate")
    for _ in range(5):
        [claim] = store.jobs.claim("worker", 1)
        assert claim.attempts == 1
        store.jobs.release(claim)
    assert store.jobs.get(claim.job_id).state == "waiting"
    with pytest.raises(LeaseLost):
        finish(store, claim)


def test_a_job_that_is_tried_again_tells_how_often_it_was(store: SqlStore) -> None:
    enroll(store, "gate")
    for attempt in (1, 2, 3):
        [claim] = store.jobs.claim("worker", 1)
        assert claim.attempts == attempt
        store.jobs.try_again(claim)
    store.jobs.try_again(claim)  # a claim that is void
    assert (store.jobs.get(claim.job_id).state, store.jobs.get(claim.job_id).attempts) == ("waiting", 3)


def test_a_job_goes_with_its_view(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    [claim] = store.jobs.claim("worker", 1)
    store.removals.delete_view(view.id)
    with pytest.raises(LeaseLost, match="deleted"):
        finish(store, claim)
    with pytest.raises(NotFound):
        store.jobs.get(claim.job_id)


def test_only_a_waiting_job_can_be_cancelled(store: SqlStore) -> None:
    submitted = enroll(store, "gate")
    assert submitted.job_id is not None
    job = store.jobs.cancel(submitted.job_id, NOW)
    assert (job.state, job.view_id, job.map, job.finished_at) == ("cancelled", submitted.view.id, "campus", NOW)
    view = store.views.get(submitted.view.id)
    assert (view.state, view.failure and view.failure[0]) == ("failed", "cancelled")
    with pytest.raises(Conflict, match="cancelled"):
        store.jobs.cancel(submitted.job_id, NOW)

    again = enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 1)
    assert claim.job_id == again.job_id
    with pytest.raises(Conflict, match="running"):
        store.jobs.cancel(claim.job_id, NOW)


def _work(url: str, data: Path) -> None:
    store = open_store(url, data)
    describe_all(store)
    store.close()


def test_two_worker_processes_do_two_hundred_jobs_once_each(reopen: Open, database_url: str, data: Path) -> None:
    store = reopen()
    for number in range(200):
        enroll(store, f"{number}")
    processes = [get_context("spawn").Process(target=_work, args=(database_url, data)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    assert store.jobs.count_waiting() == 0
    assert len(Follower(store).catch_up().vectors) == 200
    views, _ = store.views.list("campus", Filters(), limit=200)
    assert {store.views.get(view.id).state for view in views} == {"ready"}
    assert store.maps.revision("campus") == 200  # one revision each: none was finished twice


def test_an_index_that_follows_while_others_write_misses_nothing(reopen: Open) -> None:
    store = reopen()
    store.maps.put("campus", RECIPE, NOW)

    def enroll_and_describe(writer: int) -> None:
        own = reopen()
        for number in range(15):
            view = enroll(own, f"{writer} {number}").view
            describe_all(own)
            if number % 5 == 4:
                own.removals.delete_view(view.id)

    writers = [Thread(target=enroll_and_describe, args=(writer,)) for writer in range(3)]
    for writer in writers:
        writer.start()
    follower = Follower(store)
    while any(writer.is_alive() for writer in writers):
        follower.catch_up()
    for writer in writers:
        writer.join()
    describe_all(store)
    assert follower.catch_up().vectors == Follower(store).catch_up().vectors
    assert len(follower.vectors) == 3 * 12


def test_jobs_that_their_worker_does_not_know_of_go_back(store: SqlStore) -> None:
    """As when the connection broke while the claim was committed."""
    views = [enroll(store, name).view for name in ("gate", "pond", "hall")]
    held, _, others = store.jobs.claim("mine", 1), store.jobs.claim("mine", 1), store.jobs.claim("other", 1)
    snapshot = store.jobs.queue_snapshot("campus", NOW)
    assert store.jobs.claim_map_job("mine", NOW) is not None

    assert store.jobs.take_back("mine", [held[0].job_id], describe=True) == 1
    [again] = store.jobs.claim("mine", 5)
    assert (again.view.id, again.attempts) == (views[1].id, 1)
    assert store.jobs.get(snapshot.id).state == "running"
    for claim in (*held, *others, again):
        finish(store, claim)

    assert store.jobs.take_back("mine", [], describe=True) == 0
    assert store.jobs.take_back("mine", [], describe=False) == 1
    taken = store.jobs.claim_map_job("mine", NOW)
    assert taken is not None
    assert (taken.job_id, store.jobs.get(snapshot.id).attempts) == (snapshot.id, 1)


def test_the_jobs_of_a_recipe_switch_run_without_a_worker_and_are_not_taken_back(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    job = store.jobs.switch_recipe("campus", recipe("paper"), NOW)
    assert store.jobs.take_back("mine", [], describe=False) == 0
    assert store.jobs.get(job.id).state == "running"
