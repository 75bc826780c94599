"""Snapshots: made in the background, kept, given away, restored."""

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from schemas.errors import JobStopped, LeaseLost, NotFound, RevisitError, StorageFailed, unforeseen
from schemas.records import JobProgress, JobRecord, MapClaim
from schemas.snapshot import RestoredMap, SnapshotRecord

log = logging.getLogger("revisit.worker")

TOLD_EVERY_S = 0.5
"""Seconds between two reports of a job's progress; each is durable."""

PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Seconds before each further attempt, while the database or the place of the files fails: a server that restarts, or
hands over to another, is back in a few."""


class SnapshotFiles(Protocol):
    """Makes and keeps the files."""

    def make(
        self, name: str, snapshot_id: str, now: datetime, on_progress: Callable[[int, int], None]
    ) -> SnapshotRecord:
        """Write the snapshot of a map; `on_progress` is called with views done and all."""
        ...

    def all(self) -> list[SnapshotRecord]:
        """All snapshots, newest first."""
        ...

    def get(self, snapshot_id: str) -> SnapshotRecord:
        """One snapshot; raises NotFound."""
        ...

    def open(self, snapshot_id: str) -> BinaryIO:
        """Its file, for reading; raises NotFound."""
        ...

    def delete(self, snapshot_id: str) -> None:
        """Remove one; raises NotFound."""
        ...

    def receiving(self, name: str) -> Path:
        """Where a snapshot is kept while it is received and restored."""
        ...

    def admit(self, size: int) -> None:
        """Raise DiskFull unless there is room for so many bytes."""
        ...


class Restorer(Protocol):
    """Makes maps from snapshots."""

    def restore(self, path: Path, name: str | None, now: datetime, allow: Callable[[str], None]) -> RestoredMap:
        """Make a map of this name, or of its own; raises BadSnapshot, Conflict, DiskFull, and what `allow` raises."""
        ...


class SnapshotJobs(Protocol):
    """Jobs of the kind ``snapshot``."""

    def queue_snapshot(self, name: str, now: datetime) -> JobRecord:
        """Queue the making of a snapshot; raises NotFound, Conflict."""
        ...

    def get(self, job_id: str) -> JobRecord:
        """A job; raises NotFound."""
        ...

    def report(self, claim: MapClaim, progress: JobProgress) -> None:
        """Report the progress of a job; raises LeaseLost."""
        ...

    def finish_snapshot(self, claim: MapClaim, result: Mapping[str, Any], now: datetime) -> None:
        """End a job as done; raises LeaseLost."""
        ...

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; does nothing when the claim is void."""
        ...

    def release_map_job(self, claim: MapClaim) -> None:
        """Put a job back without counting the attempt."""
        ...


class SnapshotService:
    """The use-cases around snapshots, and the work of their jobs.

    Parameters
    ----------
    files, restorer, jobs
        Parts of the store.
    wake : function
        Called when a job was queued.
    rest : function
        Sleeps for a number of seconds.
    """

    def __init__(
        self,
        *,
        files: SnapshotFiles,
        restorer: Restorer,
        jobs: SnapshotJobs,
        wake: Callable[[], None],
        rest: Callable[[float], object] = time.sleep,
    ) -> None:
        self._files, self._restorer, self._jobs, self._wake, self._rest = files, restorer, jobs, wake, rest

    def queue(self, name: str) -> JobRecord:
        """Make a snapshot of a map in the background, under the id of the job; raises NotFound, Conflict."""
        job = self._jobs.queue_snapshot(name, datetime.now(UTC))
        self._wake()
        return job

    def all(self) -> list[SnapshotRecord]:
        """All snapshots, newest first."""
        return self._files.all()

    def get(self, snapshot_id: str) -> SnapshotRecord:
        """One snapshot; raises NotFound."""
        return self._files.get(snapshot_id)

    def open(self, snapshot_id: str) -> BinaryIO:
        """Its file, for reading; raises NotFound."""
        return self._files.open(snapshot_id)

    def delete(self, snapshot_id: str) -> SnapshotRecord:
        """Remove a snapshot, and return what it was; raises NotFound."""
        record = self._files.get(snapshot_id)
        self._files.delete(snapshot_id)
        return record

    def receiving(self, name: str) -> Path:
        """Where a snapshot is kept while it is received and restored; the caller removes it."""
        return self._files.receiving(name)

    def admit(self, size: int) -> None:
        """Raise DiskFull unless there is room for so many bytes."""
        self._files.admit(size)

    def restore(self, path: Path, name: str | None, allow: Callable[[str], None] = lambda name: None) -> RestoredMap:
        """Make a map from a snapshot.

        Parameters
        ----------
        path : Path
        name : str or None
            Of the new map; None: the name that the map had.
        allow : function
            Raises when the caller may not make a map of a name.

        Raises
        ------
        BadSnapshot, Conflict, DiskFull
        """
        restored = self._restorer.restore(path, name, datetime.now(UTC), allow)
        if restored.pending:
            self._wake()
        return restored

    def run(self, claim: MapClaim, stopping: Callable[[], bool]) -> None:
        """Do a job of the kind ``snapshot`` until `stopping()` is true; an error fails the job.

        It is begun anew where the database, or the place of the files, is away for a moment.
        """
        told = -TOLD_EVERY_S

        def on_progress(done: int, total: int) -> None:
            nonlocal told
            if stopping():
                raise JobStopped
            if done == total or time.monotonic() - told >= TOLD_EVERY_S:
                self._jobs.report(claim, JobProgress(done, total))
                told = time.monotonic()

        pauses = iter(PAUSES_S)
        try:
            while True:
                try:
                    record = self._files.make(claim.map, claim.job_id, datetime.now(UTC), on_progress)
                    result = {"snapshot": record.facts.id, "views": record.facts.views, "bytes": record.size}
                    self._jobs.finish_snapshot(claim, result, datetime.now(UTC))
                    return
                except StorageFailed as error:
                    pause_s = next(pauses, None)
                    if pause_s is None:
                        raise
                    log.warning("a snapshot of the map %s is begun anew: %s", claim.map, error.detail)
                    self._rest(pause_s)
                    if stopping():
                        raise JobStopped from None
        except JobStopped:
            self._jobs.release_map_job(claim)
        except LeaseLost:
            log.info("job %s was cancelled, its map deleted, or it was given to another worker", claim.job_id)
            self._drop(claim)
        except RevisitError as error:
            self._jobs.fail_map_job(claim, error.code, error.detail, datetime.now(UTC))
            self._drop(claim)
        except Exception as error:
            log.exception("making a snapshot of the map %s failed", claim.map)
            self._jobs.fail_map_job(claim, "internal", unforeseen(error), datetime.now(UTC))

    def _drop(self, claim: MapClaim) -> None:
        """Remove the file of a job that came to nothing; that of one that goes on, or is done, is another worker's."""
        with suppress(NotFound):
            if self._jobs.get(claim.job_id).state not in ("cancelled", "failed"):
                return
        with suppress(RevisitError):  # NotFound for most
            self._files.delete(claim.job_id)
