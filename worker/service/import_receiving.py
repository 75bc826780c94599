"""Receive recordings: check an upload, keep it, and queue its import."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime

from uuid6 import uuid7

from schemas.errors import NotFound
from schemas.imports import ImportOptions
from schemas.recipe import MapRecipe
from schemas.records import JobRecord
from worker.images import panorama
from worker.service.import_ports import ImportJobs, Upload, Uploads
from worker.service.opening import open_recording
from worker.service.recordings import Limits


class ImportService:
    """The use-case: receive a recording, check it, and queue its import.

    Parameters
    ----------
    uploads, jobs
        Parts of the store.
    limits : Limits
    default_recipe : MapRecipe
        Recipe of a map that an import creates.
    refuses_poor : function
        Whether a map refuses poor images.
    wake : function
        Called when a job was queued.
    describer : function
        Raises SetupError where the running encoder cannot describe the views of a map, NotFound where there is none.
    """

    def __init__(
        self,
        *,
        uploads: Uploads,
        jobs: ImportJobs,
        limits: Limits,
        default_recipe: MapRecipe,
        refuses_poor: Callable[[str], bool],
        wake: Callable[[], None],
        describer: Callable[[str], object],
    ) -> None:
        self._uploads, self._jobs, self._limits = uploads, jobs, limits
        self._default_recipe, self._refuses_poor, self._wake = default_recipe, refuses_poor, wake
        self._describer = describer

    def admit(self, name: str) -> None:
        """Raise SetupError where the images of a recording could not be described: the map is another encoder's."""
        with suppress(NotFound):  # it is made, by the running encoder
            self._describer(name)

    def receive(self, announced: int) -> Upload:
        """Begin to receive a recording of `announced` bytes (0: unknown); raises DiskFull, StorageFailed."""
        return self._uploads.receive(announced)

    def check(self, upload: Upload, options: ImportOptions) -> int:
        """Number of images that will be enrolled of a received recording.

        Raises
        ------
        BadBody, BodyTooLarge, InvalidParameters
            Nothing of it can be imported; the text says why.
        """
        upload.end()
        with open_recording(upload.path, self._limits, options) as recording:
            views = panorama.DIRECTIONS if options.panorama else 1
            return views * len(recording.items) + recording.failed

    def accept(self, upload: Upload, name: str, options: ImportOptions) -> JobRecord:
        """Queue the import of a checked recording into a map, which is made when there is none.

        Raises
        ------
        DiskFull, StorageFailed
        """
        job_id = str(uuid7())
        if options.refuse_poor is None:
            options = replace(options, refuse_poor=self._refuses_poor(name))
        self._uploads.keep(upload, job_id, asdict(options))
        try:
            job = self._jobs.queue_import(job_id, name, self._default_recipe, datetime.now(UTC))
        except BaseException:
            self._uploads.discard(job_id)
            raise
        self._wake()
        return job
