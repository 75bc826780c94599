"""Jobs: shown, listed, cancelled."""

from collections.abc import Collection
from datetime import UTC, datetime

from schemas.records import JobKind, JobRecord, JobState
from worker.service.ports import Jobs, UploadRemoval


class JobService:
    """The use-cases around jobs.

    Parameters
    ----------
    jobs : Jobs
        The store's.
    uploads : UploadRemoval
        Recordings of imports.
    """

    def __init__(self, jobs: Jobs, uploads: UploadRemoval) -> None:
        self._jobs, self._uploads = jobs, uploads

    def get(self, job_id: str) -> JobRecord:
        """One job; raises NotFound."""
        return self._jobs.get(job_id)

    def page(
        self,
        map_name: str | None,
        *,
        kinds: Collection[JobKind],
        state: JobState | None,
        cursor: str | None,
        limit: int,
        among: Collection[str] | None = None,
    ) -> tuple[list[JobRecord], str | None]:
        """A page of jobs, newest first, and the cursor of the next; raises NotFound for an unknown map.

        `kinds`: of these alone; none: of all. `among`: of these maps alone.
        """
        return self._jobs.list(map_name, kinds=kinds, state=state, cursor=cursor, limit=limit, among=among)

    def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job; raises NotFound, or Conflict when it can no longer be cancelled."""
        cancelled = self._jobs.cancel(job_id, datetime.now(UTC))
        if cancelled.kind == "import":
            self._uploads.discard(job_id)
        return cancelled
