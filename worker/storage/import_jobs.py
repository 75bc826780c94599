"""Imports: jobs that enrol the images of a recording, and report after each what came of it."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import sqlalchemy as sa

from schemas.recipe import MapRecipe
from schemas.records import JobProgress, JobRecord, MapClaim
from worker.storage import deleted_images
from worker.storage.map_jobs import MapJobs, held, queue
from worker.storage.maps import find_or_make_map
from worker.storage.rows import as_json, maps_named
from worker.storage.switching import UNFINISHED
from worker.storage.tables import JOBS, VIEWS


class ImportJobs(MapJobs):
    """Jobs of all kinds, and imports of recordings."""

    def queue_import(self, job_id: str, name: str, recipe: MapRecipe, now: datetime) -> JobRecord:
        """Queue the import of a recording that is kept already; creates the map (with `recipe`) when there is none."""
        with self._database.writing() as connection:
            return queue(connection, find_or_make_map(connection, name, recipe, now), "import", now, job_id)

    def report_import(self, claim: MapClaim, progress: JobProgress, result: Mapping[str, Any]) -> None:
        """Report the progress of an import and what came of it so far; raises LeaseLost, also when it was cancelled.

        An import that was resumed goes through the images that are enrolled already once more. Until it gets further
        than before, the stored progress stays; from then on its attempts are counted anew.
        """
        with self._database.writing(in_turn=False) as connection:
            job = held(connection, claim)
            values: dict[str, Any] = {"progress_total": progress.total}
            if job.progress_done is None or progress.done > job.progress_done:
                values |= {"progress_done": progress.done, "result": as_json(result), "attempts": 1}
            connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**values))

    def finish_import(self, claim: MapClaim, progress: JobProgress, result: Mapping[str, Any], now: datetime) -> None:
        """End an import as done; raises LeaseLost."""
        with self._database.writing(in_turn=False) as connection:
            job = held(connection, claim)
            ended = {"state": "done", "token": None, "finished_at": now}
            told = {"progress_done": progress.done, "progress_total": progress.total, "result": as_json(result)}
            connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**ended, **told))
            deleted_images.forget(connection, job.number)

    def is_imported(self, view_id: str) -> bool:
        """Whether a view was enrolled by an import, so that no other call was told of it; False when the view is gone.

        The first job that describes the view says so: jobs of imports are in the background from the start.
        """
        of = sa.select(VIEWS.c.seq).where(VIEWS.c.id == view_id).scalar_subquery()
        describes = sa.select(JOBS.c.background).where(JOBS.c.seq == of, JOBS.c.kind == "describe")
        with self._database.reading() as connection:
            return bool(connection.scalar(describes.order_by(JOBS.c.number).limit(1)))

    def unfinished_imports(self, name: str | None = None) -> set[str]:
        """Ids of the imports, into a map if one is named, that wait or run."""
        mine = sa.select(JOBS.c.id).where(JOBS.c.kind == "import", JOBS.c.state.in_(UNFINISHED))
        if name is not None:
            mine = mine.where(JOBS.c.map_id.in_(maps_named([name])))
        with self._database.reading() as connection:
            return set(connection.scalars(mine))
