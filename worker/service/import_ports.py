"""Ports of imports to the store; each declares only the methods that they call."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from schemas.recipe import MapRecipe
from schemas.records import JobProgress, JobRecord, MapClaim


class Upload(Protocol):
    """A file that is being received."""

    @property
    def path(self) -> Path:
        """Of the file."""
        ...

    def write(self, data: bytes) -> None:
        """Add bytes; raises DiskFull, StorageFailed."""
        ...

    def end(self) -> None:
        """Make what was received durable; raises DiskFull, StorageFailed."""
        ...

    def discard(self) -> None:
        """Remove it."""
        ...


class Uploads(Protocol):
    """Recordings until they are imported."""

    def receive(self, announced: int = 0) -> Upload:
        """Begin to receive a file of `announced` bytes (0: unknown); raises DiskFull, StorageFailed."""
        ...

    def keep(self, upload: Any, job_id: str, request: Mapping[str, Any]) -> None:
        """Keep a received file durably for a job; raises DiskFull, StorageFailed."""
        ...

    def opened(
        self, job_id: str, on_progress: Callable[[], None]
    ) -> AbstractContextManager[tuple[Path, dict[str, Any]]]:
        """The file of a job, which can be read during a block, and what was asked.

        Where it has to be fetched, `on_progress` is called now and then; what it raises ends that. Raises
        FileNotFoundError, ValueError, Damaged, DiskFull, StorageFailed.
        """
        ...

    def discard(self, job_id: str) -> None:
        """Remove the file of a job that has ended; does nothing when there is none."""
        ...


class ImportJobs(Protocol):
    """Jobs of the kind ``import``."""

    def get(self, job_id: str) -> JobRecord:
        """One job; raises NotFound."""
        ...

    def queue_import(self, job_id: str, name: str, recipe: MapRecipe, now: datetime) -> JobRecord:
        """Queue the import of a recording that is kept already; creates the map (with `recipe`) when there is none."""
        ...

    def report_import(self, claim: MapClaim, progress: JobProgress, result: Mapping[str, Any]) -> None:
        """Report the progress of an import and what came of it so far; raises LeaseLost."""
        ...

    def finish_import(self, claim: MapClaim, progress: JobProgress, result: Mapping[str, Any], now: datetime) -> None:
        """End an import as done; raises LeaseLost."""
        ...

    def is_imported(self, view_id: str) -> bool:
        """Whether a view was enrolled by an import, so that no other call was told of it; False when it is gone."""
        ...

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; does nothing when the claim is void."""
        ...

    def release_map_job(self, claim: MapClaim) -> None:
        """Put a job back without counting the attempt."""
        ...
