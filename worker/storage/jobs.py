"""Describe jobs: claimed by a worker, finished once, failed after three attempts."""

import secrets
from collections.abc import Callable, Collection, Mapping
from datetime import datetime
from typing import Any, get_args

import sqlalchemy as sa

from schemas.description import Description
from schemas.errors import Damaged, LeaseLost, PoorImage
from schemas.recipe import DescriptionRecipe
from schemas.records import Claim, Failure, JobKind, MapClaim
from worker.storage import clock, forgetting, switching
from worker.storage.damage import bury
from worker.storage.descriptions import keep_description
from worker.storage.part import Part
from worker.storage.rows import batches, find_map, find_recipe, log, view_record, views_of
from worker.storage.tables import DESCRIPTIONS, JOBS, MAPS, VIEWS

ATTEMPTS = 3

WORKER_DIED = (
    f"a worker took this image {ATTEMPTS} times and each time ended before the description was finished, most likely "
    "for want of memory; see the worker's log, then enrol the image again"
)


# Statements that every enrolment runs are built once: building one takes longer than running it.
_DESCRIBES = JOBS.c.kind == "describe"
_ANY_WAITING = sa.select(JOBS.c.id).where(_DESCRIBES, JOBS.c.state == "waiting").limit(1)
_OLDEST_WAITING = (
    sa.select(JOBS)
    .where(_DESCRIBES, JOBS.c.state == "waiting")
    .order_by(JOBS.c.background, JOBS.c.number)
    .limit(sa.bindparam("most", type_=sa.Integer))
    .with_for_update(skip_locked=True)
)
_CLAIMED = sa.update(JOBS).where(JOBS.c.number == sa.bindparam("of")).values(attempts=JOBS.c.attempts + 1)
_UNFINISHED = sa.select(sa.func.count()).select_from(JOBS).where(_DESCRIBES, JOBS.c.state.in_(switching.UNFINISHED))
_ENROLMENTS = _UNFINISHED.where(JOBS.c.background.is_(False))
_MAP = sa.select(MAPS.c.recipe, MAPS.c.revision, MAPS.c.drop_images).where(MAPS.c.id == sa.bindparam("of"))
_JOB_LOCKED = sa.select(JOBS).where(JOBS.c.id == sa.bindparam("of")).with_for_update()
_JOB_ENDS = sa.update(JOBS).where(JOBS.c.number == sa.bindparam("of"))
_VIEW_SETTLES = sa.update(VIEWS).where(VIEWS.c.seq == sa.bindparam("of"))


def any_recipe(recipe: DescriptionRecipe) -> bool:
    """True: of a worker that can describe by every recipe."""
    return True


class Jobs(Part):
    """The queue of describe jobs."""

    def claim(self, worker: str, count: int, able: Callable[[DescriptionRecipe], bool] = any_recipe) -> list[Claim]:
        """Claim up to `count` of the oldest jobs that wait.

        A job stays claimed until it ends or its worker is found dead (see workers.py). Enrolments, whose callers may
        be waiting, go before the jobs of a recipe switch.

        Parameters
        ----------
        worker : str
        count : int
        able : function
            Whether this worker can describe by a recipe; jobs of another one are left to others.
        """
        with self._database.reading() as connection:  # with no job to claim, no writer has to wait
            if connection.execute(_ANY_WAITING).first() is None:
                return []
        with self._database.writing(in_turn=False, durable=False) as connection:
            jobs, recipes = _oldest_waiting(connection, int(count), able)
            return self._claim(connection, jobs, recipes, worker)

    def _claim(
        self,
        connection: sa.Connection,
        jobs: list[sa.Row[Any]],
        recipes: Mapping[str, DescriptionRecipe],
        worker: str,
    ) -> list[Claim]:
        tokens = {job.number: secrets.token_hex(16) for job in jobs}
        views = {}
        for portion in batches(job.seq for job in jobs):
            rows = connection.execute(views_of(), {"seqs": portion})
            views.update({row.seq: view_record(row) for row in rows})
        jobs = [job for job in jobs if job.seq in views]
        for job in jobs:
            held = {"state": "running", "worker": worker, "token": tokens[job.number]}
            connection.execute(_CLAIMED, {"of": job.number, **held})
        return [
            Claim(
                job.id, tokens[job.number], views[job.seq], recipes[job.recipe], job.attempts + 1, bool(job.refuse_poor)
            )
            for job in jobs
        ]

    def finish(self, claim: Claim, description: Description, now: datetime) -> int:
        """Store a description and end its job; returns the revision from which it is searchable; raises LeaseLost."""
        with self._database.writing() as connection:
            job = self._held(connection, claim)
            owner = connection.execute(_MAP, {"of": job.map_id}).one()
            if job.recipe == owner.recipe:
                described = searchable = clock.tick(connection, job.map_id)
            else:  # one of a recipe switch: it is not searchable before the switch ends
                described, searchable = clock.forward(connection), int(owner.revision)
            keep_description(connection, job, claim.recipe, description, described)
            changed_over = self.settle(connection, job, "done", now)
        if changed_over is not None:  # views that had failed before are described too
            forgetting.remove_after_switch(self._database, self._images, job.map_id)
        elif owner.drop_images:
            self._images.discard([claim.view.image.sha256])
        return changed_over or searchable

    def fail(self, claim: Claim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; its view stays, `failed`, with this reason; raises LeaseLost.

        A view that is refused as poor is so by every recipe: no other job describes it.
        """
        with self._database.writing() as connection:
            job = self._held(connection, claim)
            if code == PoorImage.code:
                _refuse(connection, job, now, detail)
            changed_over = self.settle(connection, job, "failed", now, Failure(code, detail))
        if changed_over is not None:
            forgetting.remove_after_switch(self._database, self._images, job.map_id)

    def _held(self, connection: sa.Connection, claim: Claim) -> sa.Row[Any]:
        """The job of a claim that is still valid; raises LeaseLost."""
        # Locked, because another worker may be claiming it at this moment.
        job = connection.execute(_JOB_LOCKED, {"of": claim.job_id}).one_or_none()
        if job is None:
            raise LeaseLost(f"the job {claim.job_id} went with its view {claim.view.id}, which was deleted")
        if job.state != "running" or job.token != claim.token:
            raise LeaseLost(f"the job {claim.job_id} was taken from this worker and is {job.state} without it")
        return job

    def settle(
        self,
        connection: sa.Connection,
        job: sa.Row[Any],
        state: str,
        now: datetime,
        failure: Failure | None = None,
    ) -> int | None:
        """End a job and update its view; returns the map's revision if that finished a recipe switch."""
        outcome = {
            "failure_code": None if failure is None else failure.code,
            "failure_detail": None if failure is None else failure.detail,
        }
        ended = {"state": state, "token": None, "finished_at": now, **outcome}
        connection.execute(_JOB_ENDS, {"of": job.number, **ended})
        if job.recipe == connection.execute(_MAP, {"of": job.map_id}).one().recipe:
            view_state = "ready" if state == "done" else "failed"
            connection.execute(_VIEW_SETTLES, {"of": job.seq, "state": view_state, **outcome})
        return switching.finish_if_done(connection, job.map_id, now)

    def release(self, claim: Claim) -> None:
        """Put a job back without counting the attempt; does nothing when the claim is void."""
        self._put_back(claim)

    def try_again(self, claim: Claim) -> None:
        """Put a job back after an attempt that counts; does nothing when the claim is void."""
        self._put_back(claim, uncounted=0)

    def take_back(self, worker: str, held: Collection[str], *, describe: bool) -> int:
        """Put back jobs that a worker claimed but does not hold; returns how many.

        There are such jobs where it never learned that its claim was committed, or could not put them back itself.
        `describe`: jobs to describe views; otherwise jobs of maps.
        """
        kinds = [kind for kind in get_args(JobKind) if (kind == "describe") == describe]
        lost = JOBS.c.kind.in_(kinds), JOBS.c.state == "running", JOBS.c.worker == worker, JOBS.c.token.is_not(None)
        with self._database.writing(in_turn=False, frees=True) as connection:
            back = {"state": "waiting", "worker": None, "token": None, "attempts": JOBS.c.attempts - 1}
            return connection.execute(sa.update(JOBS).where(*lost, JOBS.c.id.not_in(held)).values(**back)).rowcount

    def _put_back(self, claim: Claim | MapClaim, *, uncounted: int = 1) -> None:
        with self._database.writing(in_turn=False, frees=True) as connection:
            connection.execute(
                sa.update(JOBS)
                .where(JOBS.c.id == claim.job_id, JOBS.c.state == "running", JOBS.c.token == claim.token)
                .values(state="waiting", worker=None, token=None, attempts=JOBS.c.attempts - uncounted)
            )

    def count_pending(self, name: str) -> int:
        """Number of a map's views that are not described yet by its recipe; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            mine = JOBS.c.map_id == row.id, JOBS.c.recipe == row.recipe, JOBS.c.kind == "describe"
            unfinished = JOBS.c.state.in_(switching.UNFINISHED)
            return connection.scalar(sa.select(sa.func.count()).select_from(JOBS).where(*mine, unfinished)) or 0

    def count_waiting(self, *, redescriptions: bool = False) -> int:
        """Number of enrolments not yet described.

        Parameters
        ----------
        redescriptions : bool
            Also count the jobs of recipe switches, which do not delay enrolments.
        """
        with self._database.reading() as connection:
            return int(connection.scalar(_UNFINISHED if redescriptions else _ENROLMENTS) or 0)


def _oldest_waiting(
    connection: sa.Connection, most: int, able: Callable[[DescriptionRecipe], bool]
) -> tuple[list[sa.Row[Any]], dict[str, DescriptionRecipe]]:
    """The oldest jobs that wait, and their recipes by id.

    Jobs of a recipe that is damaged beyond use are left for `revisit doctor`, and those that this worker is not `able`
    to do for others; those behind them go on.
    """
    recipes: dict[str, DescriptionRecipe] = {}
    left: list[str] = []
    oldest = _OLDEST_WAITING
    while True:
        jobs = list(connection.execute(oldest, {"most": most}))
        before = len(left)
        for recipe in {job.recipe for job in jobs}.difference(recipes):
            try:
                found = find_recipe(connection, recipe)
            except Damaged as error:
                log.error("jobs are left alone: %s", error.detail)
                left.append(recipe)
                continue
            if able(found):
                recipes[recipe] = found
            else:
                left.append(recipe)
        if len(left) == before:
            return jobs, recipes
        oldest = _OLDEST_WAITING.where(JOBS.c.recipe.not_in(left))


def _refuse(connection: sa.Connection, job: sa.Row[Any], now: datetime, detail: str) -> None:
    """Fail the view of a job as poor, cancel its other jobs, as those of a recipe switch, and drop what these made."""
    refused = {"failure_code": PoorImage.code, "failure_detail": detail}
    others = JOBS.c.seq == job.seq, JOBS.c.number != job.number, JOBS.c.state.in_(switching.UNFINISHED)
    ended = {"state": "cancelled", "token": None, "finished_at": now, **refused}
    connection.execute(sa.update(JOBS).where(*others).values(**ended))
    connection.execute(_VIEW_SETTLES, {"of": job.seq, "state": "failed", **refused})
    if connection.execute(sa.delete(DESCRIPTIONS).where(DESCRIPTIONS.c.seq == job.seq)).rowcount:
        bury(connection, job.map_id, [job.seq])
