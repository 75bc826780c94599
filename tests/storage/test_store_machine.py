"""A store and a dict are driven through the same life, and must agree at each step."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from datetime import timedelta

import pytest
from hypothesis import HealthCheck, settings, strategies as st
from hypothesis.stateful import (
    Bundle,
    MultipleResults,
    RuleBasedStateMachine,
    consumes,
    invariant,
    multiple,
    precondition,
    rule,
    run_state_machine_as_test,
)

from schemas.errors import Conflict, LeaseLost
from schemas.recipe import MapRecipe
from schemas.records import Claim, Filters, ViewAttributes
from tests.storage.databases import data_folder, postgres_schema, sqlite_url
from tests.storage.material import NOW, Follower, enroll, finish, give_sign, image, recipe, vector
from worker.storage.store import open_store

RECIPES = [recipe("default"), recipe("paper")]
MAPS = st.sampled_from(["campus", "museum"])
IMAGES = st.sampled_from(["gate", "pond", "stairs"])
PLACES = st.sampled_from([None, "north", "south"])
WORKERS = st.sampled_from(["one", "two"])


@dataclass
class ModelJob:
    """A job, as simple as can be."""

    recipe: str
    background: bool
    number: int
    attempts: int = 0
    token: str | None = None
    worker: str | None = None


@dataclass
class ModelView:
    """A view: its unfinished jobs, and the recipes that described it."""

    id: str
    seq: int
    place: str | None
    jobs: list[ModelJob] = field(default_factory=list)
    described: set[str] = field(default_factory=set)

    def job(self, recipe_id: str) -> ModelJob | None:
        return next((job for job in self.jobs if job.recipe == recipe_id), None)

    def state(self, recipe_id: str) -> str:
        if recipe_id in self.described:
            return "ready"
        return "pending" if self.job(recipe_id) else "failed"


@dataclass
class ModelMap:
    """A map: its views by image."""

    recipe: str
    following: str | None = None
    retrying: int | None = None
    views: dict[str, ModelView] = field(default_factory=dict)

    def is_retrying(self) -> bool:
        """Whether views that had failed are being described again by the recipe in use."""
        return self.retrying is not None and any(
            job.recipe == self.recipe and job.background and job.number > self.retrying
            for view in self.views.values()
            for job in view.jobs
        )

    def change_over_if_done(self) -> None:
        if self.following and not any(view.job(self.following) for view in self.views.values()):
            self.recipe, self.following = self.following, None
            for view in self.views.values():
                view.jobs = [job for job in view.jobs if job.recipe == self.recipe or job.token is not None]


class StoreMachine(RuleBasedStateMachine):
    """Enrolments, work, deletions and recipe switches in any order, with workers that are late or die."""

    claims: Bundle[Claim] = Bundle("claims")

    def __init__(self) -> None:
        super().__init__()
        self.surroundings = ExitStack()
        self.folder = self.surroundings.enter_context(data_folder())
        self.url = self.surroundings.enter_context(self.database())
        self.store = open_store(self.url, self.folder)
        self.maps: dict[str, ModelMap] = {}
        self.followers: dict[str, Follower] = {}
        self.now = NOW
        self.queued = 0

    def database(self) -> AbstractContextManager[str]:
        return nullcontext(sqlite_url(self.folder))

    def teardown(self) -> None:
        self.store.close()
        self.surroundings.close()

    def queue(self, view: ModelView, recipe_id: str, *, background: bool) -> None:
        if recipe_id not in view.described and view.job(recipe_id) is None:
            self.queued += 1
            view.jobs.append(ModelJob(recipe_id, background, self.queued))

    def everything(self) -> Iterator[tuple[ModelMap, ModelView]]:
        for of in self.maps.values():
            for view in of.views.values():
                yield of, view

    @rule(name=MAPS, shown=IMAGES, place=PLACES)
    def enrol(self, name: str, shown: str, place: str | None) -> None:
        of = self.maps.setdefault(name, ModelMap(RECIPES[0].description.id))
        known = of.views.get(shown)
        if known is not None and place not in (None, known.place):
            with pytest.raises(Conflict):
                enroll(self.store, shown, map=name, attributes=ViewAttributes(place), now=self.now)
            return
        submitted = enroll(self.store, shown, map=name, attributes=ViewAttributes(place), now=self.now)
        assert submitted.created == (known is None)
        if known is None:
            known = of.views[shown] = ModelView(submitted.view.id, submitted.view.seq, place)
        if submitted.created or known.state(of.recipe) == "failed":
            self.queue(known, of.recipe, background=False)
            if of.following:
                self.queue(known, of.following, background=True)

    @rule(target=claims, count=st.integers(1, 3), worker=WORKERS)
    def claim(self, count: int, worker: str) -> MultipleResults[Claim]:
        give_sign(self.store, worker)
        open_jobs = [
            (job.background, job.number, view, job)
            for _, view in self.everything()
            for job in view.jobs
            if job.token is None
        ]
        expected = sorted(open_jobs, key=lambda entry: entry[:2])[:count]
        claims = self.store.jobs.claim(worker, count)
        assert [(claim.view.id, claim.recipe.id) for claim in claims] == [(v.id, job.recipe) for *_, v, job in expected]
        for claim, (*_, job) in zip(claims, expected, strict=True):
            job.attempts += 1
            job.token, job.worker = claim.token, worker
            assert claim.attempts == job.attempts
        return multiple(*claims)

    def held(self, claim: Claim) -> tuple[ModelMap, ModelView, ModelJob] | None:
        for of, view in self.everything():
            for job in view.jobs:
                if job.token == claim.token:
                    return of, view, job
        return None

    @rule(claim=claims, good=st.booleans())
    def settle(self, claim: Claim, good: bool) -> None:
        held = self.held(claim)
        if held is None:
            with pytest.raises(LeaseLost):
                finish(self.store, claim, self.now)
            return
        of, view, job = held
        if good:
            finish(self.store, claim, self.now)
            view.described.add(job.recipe)
        else:
            self.store.jobs.fail(claim, "nothing-static", "only cars", self.now)
        view.jobs.remove(job)
        of.change_over_if_done()

    @rule(claim=consumes(claims), counts=st.booleans())
    def put_back(self, claim: Claim, counts: bool) -> None:
        (self.store.jobs.try_again if counts else self.store.jobs.release)(claim)
        held = self.held(claim)
        if held is not None:
            job = held[2]
            job.attempts -= not counts
            job.token = job.worker = None

    @rule(worker=WORKERS)
    def a_worker_falls_silent(self, worker: str) -> None:
        left = [(view, job) for _, view in self.everything() for job in view.jobs if job.worker == worker]
        assert self.store.workers.bury([worker], self.now) == len(left)
        for view, job in left:
            job.token = job.worker = None
            if job.attempts >= 3:
                view.jobs.remove(job)
        for of in self.maps.values():
            of.change_over_if_done()

    @rule(seconds=st.sampled_from([1, 60]))
    def time_goes_by(self, seconds: int) -> None:
        self.now += timedelta(seconds=seconds)

    @precondition(lambda self: any(of.views for of in self.maps.values()))
    @rule(data=st.data())
    def delete_view(self, data: st.DataObject) -> None:
        name, shown = data.draw(st.sampled_from([(n, p) for n, of in self.maps.items() for p in of.views]))
        view = self.maps[name].views.pop(shown)
        others = sum(shown in of.views for of in self.maps.values())
        assert self.store.removals.delete_view(view.id).images == (0 if others else 1)
        self.maps[name].change_over_if_done()

    @precondition(lambda self: self.maps)
    @rule(data=st.data())
    def delete_map(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(self.maps)))
        assert self.store.removals.delete_map(name).views == len(self.maps.pop(name).views)
        self.followers.pop(name, None)

    @precondition(lambda self: self.maps)
    @rule(data=st.data(), to=st.sampled_from(RECIPES))
    def switch_recipe(self, data: st.DataObject, to: MapRecipe) -> None:
        name = data.draw(st.sampled_from(sorted(self.maps)))
        of = self.maps[name]
        if of.following or of.is_retrying():
            with pytest.raises(Conflict):
                self.store.jobs.switch_recipe(name, to, self.now)
            return
        before = self.queued
        for view in of.views.values():
            self.queue(view, to.description.id, background=True)
        progress = self.store.jobs.switch_recipe(name, to, self.now).progress
        assert progress is not None
        assert progress.total == self.queued - before
        if to.description.id == of.recipe:
            of.retrying = before
        else:
            of.following = to.description.id
            of.change_over_if_done()

    @rule()
    def restart(self) -> None:
        self.store.close()
        self.store = open_store(self.url, self.folder)
        self.store.recover()
        for follower in self.followers.values():
            follower.store = self.store

    @invariant()
    def an_index_that_follows_equals_the_store(self) -> None:
        for name, of in self.maps.items():
            follower = self.followers.setdefault(name, Follower(self.store, name))
            views, _ = self.store.views.list(name, Filters(), state="ready")
            expected = {view.seq: vector(view, of.recipe) for view in views}
            assert follower.catch_up().vectors == expected
            assert Follower(self.store, name).catch_up().vectors == expected

    @invariant()
    def store_and_dict_agree(self) -> None:
        assert [record.name for record in self.store.maps.all()] == sorted(self.maps)
        for name, of in self.maps.items():
            assert self.store.maps.get(name).description.id == of.recipe
            views, _ = self.store.views.list(name, Filters())
            expected = sorted(of.views.values(), key=lambda view: view.seq)
            assert [(v.id, v.attributes.place, v.state) for v in views] == [
                (v.id, v.place, v.state(of.recipe)) for v in expected
            ]
            for shown, view in of.views.items():
                assert self.store.views.image(view.id) == image(shown)
        unfinished = [job for _, view in self.everything() for job in view.jobs]
        assert self.store.jobs.count_waiting(redescriptions=True) == len(unfinished)
        assert self.store.jobs.count_waiting() == sum(not job.background for job in unfinished)

    @invariant()
    def no_image_is_kept_without_a_view(self) -> None:
        files = {path.read_bytes() for path in (self.folder / "pictures").rglob("??/??/*")}
        assert files == {image(shown) for of in self.maps.values() for shown in of.views}


class PostgresMachine(StoreMachine):
    """The same life on PostgreSQL."""

    def database(self) -> AbstractContextManager[str]:
        return postgres_schema()


EXAMPLES = settings(max_examples=10, stateful_step_count=25, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("machine", [StoreMachine, PostgresMachine])
def test_a_store_and_a_dict_that_live_the_same_life_agree(machine: type[StoreMachine]) -> None:
    run_state_machine_as_test(machine, settings=EXAMPLES)
