"""Jobs of maps; and all jobs: shown, listed, cancelled.

A job of the kind ``recipe`` runs until the last of the map's views is described; one of the kind ``shadow`` is then
claimed by a worker, which compares answers (see shadow_jobs.py). One of the kind ``vocabulary`` is
first claimed by a worker, which trains the vocabulary, and then runs like one of the kind ``recipe``. One of the kind
``snapshot`` is claimed by a worker, which writes the file. It leaves its map as it is and may run beside the others.
``import`` is claimed by a worker until the last image of its recording is described (see import_jobs.py).
"""

import json
import secrets
from collections.abc import Callable, Collection, Mapping
from datetime import datetime
from functools import cache
from typing import Any, get_args

import sqlalchemy as sa
from uuid6 import uuid7

from schemas.errors import Cancelled, Conflict, Damaged, LeaseLost, NotFound, RecipeChanged
from schemas.recipe import DescriptionRecipe, MapRecipe
from schemas.records import Failure, JobKind, JobProgress, JobRecord, JobState, MapClaim
from worker.storage import checksums, deleted_images, forgetting, switching
from worker.storage.jobs import ATTEMPTS, Jobs, any_recipe
from worker.storage.paging import cursor_after, read_cursor
from worker.storage.rows import as_json, find_map, find_recipe, inserting, keep_recipe, log, map_record, maps_named
from worker.storage.switching import UNFINISHED
from worker.storage.tables import JOBS, MAPS, VIEWS
from worker.storage.vocabularies import keep_vocabulary

WORKER_DIED = f"a worker began this {ATTEMPTS} times and each time ended before it was finished; see the worker's log"

CANCELLED = Failure(Cancelled.failure, "its description was cancelled; enrol the image again to have it described")


class MapJobs(Jobs):
    """Jobs of all kinds."""

    drop_files: Callable[[str], None] | None = None
    """Removes the files of a job, by its id. For jobs that fail because their workers died, which cannot do it."""

    # recipe

    def switch_recipe(
        self, name: str, recipe: MapRecipe, now: datetime, made_from: MapRecipe | None = None
    ) -> JobRecord:
        """Begin to describe a map's views by another recipe.

        Searches use the old recipe until the last view is described by the new one; then the map switches in one
        transaction. Descriptions by the new recipe that are still stored are used again.

        Parameters
        ----------
        name : str
        recipe : MapRecipe
        now : datetime
        made_from : MapRecipe or None
            The map's recipe, of which `recipe` has what is not changed.

        Raises
        ------
        NotFound
        RecipeChanged
            The map no longer has the recipe `made_from`.
        Conflict
            Another job of the map has not finished, or its images are not kept.
        """
        with self._database.writing() as connection:
            row = find_map(connection, name)
            refuse_second(connection, row)
            refuse_changed(connection, row, made_from)
            kept = keep_recipe(connection, recipe.description)
            switching.begin(connection, row, kept, recipe.ranking.model_dump_json(), None, now)
            latest = sa.select(JOBS.c.id).where(JOBS.c.map_id == row.id, JOBS.c.kind == "recipe")
            job_id = connection.scalar(latest.order_by(JOBS.c.number.desc()).limit(1))
            return record_of(connection, str(job_id))

    # vocabulary

    def queue_vocabulary(self, name: str, now: datetime) -> JobRecord:
        """Queue the training of a vocabulary on a map's views; raises NotFound, or Conflict as `switch_recipe`."""
        with self._database.writing() as connection:
            row = find_map(connection, name)
            refuse_second(connection, row)
            switching.refuse_without_images(connection, row)
            return queue(connection, row, "vocabulary", now)

    # snapshot

    def queue_snapshot(self, name: str, now: datetime) -> JobRecord:
        """Queue the making of a snapshot of a map; raises NotFound, or Conflict when another is being made of it."""
        with self._database.writing() as connection:
            row = find_map(connection, name)
            other = sa.select(JOBS.c.id).where(
                JOBS.c.map_id == row.id, JOBS.c.kind == "snapshot", JOBS.c.state.in_(UNFINISHED)
            )
            if (job_id := connection.scalar(other.limit(1))) is not None:
                raise Conflict(
                    f"a snapshot of the map {name!r} is being made already, by the job {job_id}; wait until it has "
                    f"finished, or DELETE /jobs/{job_id}"
                )
            return queue(connection, row, "snapshot", now)

    def finish_snapshot(self, claim: MapClaim, result: Mapping[str, Any], now: datetime) -> None:
        """End a claimed job as done; raises LeaseLost."""
        with self._database.writing() as connection:
            job = held(connection, claim)
            ended = {"state": "done", "finished_at": now, "token": None}
            done = {"progress_done": job.progress_total, "result": as_json(dict(result))}
            connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**ended, **done))

    # claims

    def claim_map_job(
        self, worker: str, now: datetime, able: Callable[[DescriptionRecipe], bool] = any_recipe
    ) -> MapClaim | None:
        """Claim the oldest job of a map that waits; a job at most three times.

        Jobs that describe by a recipe are left to others where this worker is not `able` to.
        """
        waits = (JOBS.c.kind == "shadow") | (
            JOBS.c.kind.in_(("vocabulary", "snapshot", "import")) & JOBS.c.recipe.is_(None)
        )
        mine = sa.select(JOBS).where(waits, JOBS.c.state == "waiting").order_by(JOBS.c.number).limit(1)
        with self._database.reading() as connection:
            if connection.execute(mine).first() is None:
                return None
        with self._database.writing(in_turn=False, durable=False) as connection:
            left: list[int] = []
            while True:
                others = mine.where(JOBS.c.number.not_in(left)).with_for_update(skip_locked=True)
                job = connection.execute(others).one_or_none()
                if job is None:
                    return None
                if _can_be_done(connection, job, able):
                    break
                left.append(job.number)
            if job.attempts < ATTEMPTS:
                token = secrets.token_hex(16)
                held = {"state": "running", "worker": worker, "token": token}
                connection.execute(
                    sa.update(JOBS).where(JOBS.c.number == job.number).values(attempts=JOBS.c.attempts + 1, **held)
                )
                name = connection.scalar(sa.select(MAPS.c.name).where(MAPS.c.id == job.map_id))
                return MapClaim(job.id, job.kind, token, str(name))
            _fail(connection, job, now, Failure("worker-died", WORKER_DIED))
        if self.drop_files is not None:
            self.drop_files(job.id)
        return None

    def report(self, claim: MapClaim, progress: JobProgress) -> None:
        """Report the progress of a claimed job; raises LeaseLost, also when it was cancelled."""
        with self._database.writing(in_turn=False, durable=False) as connection:
            job = held(connection, claim)
            told = {"progress_done": progress.done, "progress_total": progress.total}
            connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**told))

    def finish_training(self, claim: MapClaim, recipe: DescriptionRecipe, tensors: bytes, now: datetime) -> None:
        """Begin to describe the map's views with the trained vocabulary, as the same job; raises LeaseLost.

        `tensors`: the vocabulary. It is stored with the recipe, or another process would remove it as one of no recipe.
        """
        with self._database.writing() as connection:
            job = held(connection, claim)
            keep_vocabulary(connection, str(recipe.vocabulary), tensors)
            row = connection.execute(sa.select(MAPS).where(MAPS.c.id == job.map_id)).one()
            kept = keep_recipe(connection, recipe)
            running = {"recipe": kept, "token": None, "progress_done": None}
            connection.execute(
                sa.update(JOBS).where(JOBS.c.number == job.number).values(progress_total=None, **running)
            )
            switching.begin(connection, row, kept, row.ranking, job.id, now)

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        """End a claimed job as failed, with this reason; does nothing when the claim is void."""
        with self._database.writing() as connection:
            try:
                job = held(connection, claim)
            except LeaseLost as error:
                log.info("a failure of the job %s counts for nothing: %s", claim.job_id, error.detail)
                return
            _fail(connection, job, now, Failure(code, detail))

    def release_map_job(self, claim: MapClaim) -> None:
        """Put a claimed job back without counting the attempt; does nothing when the claim is void."""
        self._put_back(claim)

    # all kinds

    def get(self, job_id: str) -> JobRecord:
        """One job; raises NotFound."""
        with self._database.reading() as connection:
            return record_of(connection, job_id)

    def list(
        self,
        name: str | None,
        *,
        kinds: Collection[JobKind] = (),
        state: JobState | None = None,
        cursor: str | None = None,
        limit: int = 50,
        among: Collection[str] | None = None,
    ) -> "tuple[list[JobRecord], str | None]":
        """A page of jobs, newest first, and the cursor of the next; raises NotFound for an unknown map.

        `kinds`: only jobs of these kinds, of all where it is empty. `among`: only jobs of these maps.
        """
        # Their numbers first: a map has a job for each view, and whole rows of all would be read to be sorted.
        numbers = sa.select(JOBS.c.number).join(MAPS, _NAMED).order_by(JOBS.c.number.desc()).limit(limit + 1)
        if cursor is not None:
            [last] = read_cursor("jobs", cursor, int)
            numbers = numbers.where(JOBS.c.number < last)
        if among is not None:
            numbers = numbers.where(JOBS.c.map_id.in_(maps_named(among)))
        if kinds:
            numbers = numbers.where(JOBS.c.kind.in_(kinds))
        if state is not None:
            numbers = numbers.where(JOBS.c.state == state)
        with self._database.reading() as connection:
            if name is not None:
                numbers = numbers.where(JOBS.c.map_id == find_map(connection, name).id)
            listed = JOBS.c.number.in_(list(connection.scalars(numbers)))
            rows = [*connection.execute(_job_rows().where(listed).order_by(JOBS.c.number.desc()))]
            records = [_of_row(connection, row) for row in rows[:limit]]
        return records, cursor_after("jobs", rows[limit - 1].number) if len(rows) > limit else None

    def cancel(self, job_id: str, now: datetime) -> JobRecord:
        """Cancel a describe job that is waiting (its view is then failed), or a job of a map that has not finished.

        Raises
        ------
        NotFound
        Conflict
            The job can no longer be cancelled.
        """

        def end(connection: sa.Connection) -> tuple[JobRecord, int | None]:  # and the map whose switch has ended
            job = connection.execute(sa.select(JOBS).where(JOBS.c.id == job_id).with_for_update()).one_or_none()
            if job is None:
                raise NotFound("job", job_id)
            allowed = ("waiting",) if job.kind == "describe" else UNFINISHED
            if job.state not in allowed:
                raise Conflict(f"the job {job_id} is {job.state}; only a {' or '.join(allowed)} job can be cancelled")
            ended_switch = job.kind == "recipe"
            if job.kind == "describe":
                ended_switch = self.settle(connection, job, "cancelled", now, CANCELLED) is not None
            else:
                if job.recipe == connection.scalar(sa.select(MAPS.c.recipe).where(MAPS.c.id == job.map_id)):
                    switching.stop_trying_again(connection, job, now, CANCELLED)
                elif job.recipe is not None:
                    switching.stop(connection, job.map_id, job.recipe, now)
                kept = _LEFT.get(job.kind, switching.DISCARDED)
                _end(connection, job.number, "cancelled", now, Failure("cancelled", kept))
            return record_of(connection, job_id), job.map_id if ended_switch else None

        # Its recording, or its half of a snapshot, may be what fills the disk.
        cancelled, switched = self._database.freeing(end)
        if switched is not None:
            forgetting.remove_after_switch(self._database, self._images, switched)
        return cancelled


_LEFT = {"snapshot": "no snapshot was made", "import": "what was imported before stays"}
"""What is left of a job that was cancelled, by its kind."""


def _can_be_done(connection: sa.Connection, job: sa.Row[Any], able: Callable[[DescriptionRecipe], bool]) -> bool:
    """Whether a worker that is `able` to describe by some recipes can do a job."""
    if job.kind not in ("vocabulary", "shadow"):
        return True  # what is imported or written is described by other jobs, or was
    needed = job.recipe or connection.scalar(sa.select(MAPS.c.recipe).where(MAPS.c.id == job.map_id))
    try:
        return able(find_recipe(connection, str(needed)))
    except Damaged:
        return True  # the job fails of it, and says so


def refuse_second(connection: sa.Connection, row: sa.Row[Any]) -> None:
    """Raise Conflict when another job of this map has not finished, or its shadow waits to be decided on."""
    other = sa.select(JOBS.c.id, JOBS.c.kind).where(
        JOBS.c.map_id == row.id, JOBS.c.kind.in_(("recipe", "shadow", "vocabulary")), JOBS.c.state.in_(UNFINISHED)
    )
    found = connection.execute(other.limit(1)).one_or_none()
    if found is not None:
        raise Conflict(
            f"the map {row.name!r} is being changed already, by the {found.kind} job {found.id}; wait until it has "
            f"finished, or DELETE /jobs/{found.id}"
        )
    switching.refuse_with_shadow(row)


def refuse_changed(connection: sa.Connection, row: sa.Row[Any], made_from: MapRecipe | None) -> None:
    """Raise RecipeChanged when a map no longer has the recipe that its next one was made from."""
    if made_from is not None and map_record(connection, row).recipe != made_from:
        raise RecipeChanged(f"the recipe or the ranking of the map {row.name!r} was changed meanwhile; try again")


def queue(
    connection: sa.Connection, row: sa.Row[Any], kind: JobKind, now: datetime, job_id: str | None = None
) -> JobRecord:
    """Queue a job of a map for a worker to claim; `job_id` None makes one."""
    job_id = job_id or str(uuid7())
    new = {"id": job_id, "kind": kind, "map_id": row.id, "background": True}
    connection.execute(inserting(JOBS), {**new, "state": "waiting", "attempts": 0, "created_at": now})
    return record_of(connection, job_id)


def held(connection: sa.Connection, claim: MapClaim) -> sa.Row[Any]:
    """The job of a claim that is still valid; raises LeaseLost."""
    job = connection.execute(sa.select(JOBS).where(JOBS.c.id == claim.job_id).with_for_update()).one_or_none()
    if job is None:
        raise LeaseLost(f"the job {claim.job_id} went with its map {claim.map}, which was deleted")
    if job.state != "running" or job.token != claim.token:
        raise LeaseLost(f"the job {claim.job_id} is {job.state} without this worker")
    return job


def _fail(connection: sa.Connection, job: sa.Row[Any], now: datetime, failure: Failure) -> None:
    """End a job as failed; with that of a shadow goes the shadow."""
    if job.kind == "shadow":
        switching.stop(connection, job.map_id, job.recipe, now)
    _end(connection, job.number, "failed", now, failure)


def _end(connection: sa.Connection, number: int, state: JobState, now: datetime, failure: Failure) -> None:
    ended = {"state": state, "token": None, "finished_at": now}
    reason = {"failure_code": failure.code, "failure_detail": failure.detail}
    connection.execute(sa.update(JOBS).where(JOBS.c.number == number).values(**ended, **reason))
    deleted_images.forget(connection, number)


_NAMED = sa.and_(MAPS.c.id == JOBS.c.map_id, MAPS.c.name.is_not(None))


@cache
def _job_rows() -> sa.Select[Any]:
    """Selects jobs with the name of their map and the id of their view."""
    return (
        sa.select(JOBS, MAPS.c.name.label("map"), VIEWS.c.id.label("view_id"))
        .select_from(JOBS.join(MAPS, _NAMED))
        .outerjoin(VIEWS, VIEWS.c.seq == JOBS.c.seq)
    )


def record_of(connection: sa.Connection, job_id: str) -> JobRecord:
    """One job; raises NotFound."""
    row = connection.execute(_job_rows().where(JOBS.c.id == job_id)).one_or_none()
    if row is None:
        raise NotFound("job", job_id)
    return _of_row(connection, row)


def _of_row(connection: sa.Connection, row: sa.Row[Any]) -> JobRecord:
    if not checksums.is_whole(JOBS, row):
        return _damaged_record(row)
    result: Mapping[str, Any] | None = None if row.result is None else json.loads(row.result)
    return JobRecord(
        id=row.id,
        kind=row.kind,
        state=row.state,
        map=row.map,
        view_id=row.view_id,
        attempts=row.attempts,
        progress=_progress(connection, row),
        result=result,
        created_at=row.created_at,
        finished_at=row.finished_at,
        failure=None if row.failure_code is None else Failure(row.failure_code, row.failure_detail),
    )


def _damaged_record(row: sa.Row[Any]) -> JobRecord:
    """A job whose row is damaged, so that nothing of it is shown but its name."""
    log.error("job %s of map %s: its row does not fit its checksum; `./revisit doctor` says more", row.id, row.map)
    return JobRecord(
        id=str(row.id),
        kind=row.kind if row.kind in get_args(JobKind) else "describe",
        state="failed",
        map=row.map,
        view_id=row.view_id,
        attempts=0,
        progress=None,
        result=None,
        created_at=row.created_at,
        finished_at=None,
        failure=Failure(Damaged.code, "the stored row of this job is damaged; `./revisit doctor --repair` mends it"),
    )


def _progress(connection: sa.Connection, row: sa.Row[Any]) -> JobProgress | None:
    """Progress of a job of a map: reported by its worker, or counted over the describe jobs for a recipe."""
    if row.kind == "describe":
        return None
    if row.recipe is None or row.state != "running" or row.token is not None:  # a shadow that is compared has a token
        return None if row.progress_total is None else JobProgress(row.progress_done, row.progress_total)
    return JobProgress(*switching.count_jobs(connection, row.map_id, row.recipe, row.number))
