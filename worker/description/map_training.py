"""Training of a vocabulary on a map's own views, as a durable job."""

import logging
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from schemas.description import PixelField
from schemas.errors import (
    BadImage,
    Damaged,
    DiskFull,
    EncoderAway,
    JobStopped,
    LeaseLost,
    NotFound,
    RevisitError,
    StorageFailed,
    unforeseen,
)
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.records import Filters, JobProgress, MapClaim, MapRecord, ViewRecord
from worker.description import vocabularies
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, field_alone

log = logging.getLogger("revisit.worker")

PAGE = 500
"""Views listed at a time."""


class MapReader(Protocol):
    """Maps by name."""

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...


class ViewReader(Protocol):
    """Views and their images."""

    def list(
        self,
        name: str | None,
        filters: Filters,
        *,
        state: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[list[ViewRecord], str | None]:
        """A page of views."""
        ...

    def image(self, view_id: str) -> bytes:
        """The enrolled bytes; raises NotFound."""
        ...


class TrainingJobs(Protocol):
    """Jobs of maps that a worker has claimed."""

    def report(self, claim: MapClaim, progress: JobProgress) -> None:
        """Report the progress of a job; raises LeaseLost."""
        ...

    def finish_training(self, claim: MapClaim, recipe: DescriptionRecipe, tensors: bytes, now: datetime) -> None:
        """Store the trained vocabulary (safetensors), and queue the description of the map's views by the recipe that
        names it; raises LeaseLost."""
        ...

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; does nothing when the claim is void."""
        ...

    def release_map_job(self, claim: MapClaim) -> None:
        """Put a job back without counting the attempt."""
        ...


class VocabularyTrainer:
    """Runs jobs of the kind ``vocabulary``.

    Parameters
    ----------
    maps, views, jobs
        Parts of the store.
    describers : Describers
    scheduler : Scheduler
    decode : function
        Bytes to Image; raises BadImage.
    """

    def __init__(
        self,
        *,
        maps: MapReader,
        views: ViewReader,
        jobs: TrainingJobs,
        describers: Describers,
        scheduler: Scheduler,
        decode: Callable[[bytes], Image],
    ) -> None:
        self._maps, self._views, self._jobs = maps, views, jobs
        self._describers, self._scheduler, self._decode = describers, scheduler, decode

    def run(self, claim: MapClaim, stopping: Callable[[], bool]) -> None:
        """Train a vocabulary and queue the descriptions by it until `stopping()` is true; an error fails the job.

        Raises
        ------
        DiskFull, StorageFailed
            The job is to be put back, and tried again.
        """
        try:
            recipe = self._maps.get(claim.map).description
            describer = self._describers.of(recipe)
            with _Heartbeat(lambda progress: self._jobs.report(claim, progress)) as beat:
                learned = vocabularies.train(
                    self._fields(claim, recipe.parameters.seed, beat, stopping),
                    lambda field: describer.segment(field).static,
                    recipe.parameters,
                    recipe.parameters.seed,
                )
            trained = recipe.model_copy(update={"vocabulary": learned.digest})
            self._jobs.finish_training(claim, trained, learned.tensors, _now())
        except (JobStopped, EncoderAway):  # the latter only where the service stops while the encoder is away
            self._jobs.release_map_job(claim)
        except LeaseLost:
            log.info("job %s was cancelled, or given to another worker", claim.job_id)
        except (DiskFull, StorageFailed):  # the loop puts it back, once it can
            raise
        except ValueError as error:
            self._jobs.fail_map_job(
                claim, "too-few-pictures", f"{error}; enrol more views of different places first", _now()
            )
        except RevisitError as error:
            self._jobs.fail_map_job(claim, error.code, error.detail, _now())
        except Exception as error:
            log.exception("training a vocabulary for the map %s failed", claim.map)
            self._jobs.fail_map_job(claim, "internal", unforeseen(error), _now())

    def _fields(
        self, claim: MapClaim, seed: int, beat: "_Heartbeat", stopping: Callable[[], bool]
    ) -> Iterator[PixelField]:
        """Pixel fields of a sample of the map's views, in random order by `seed`; queries are encoded before them.

        Views are left out that were deleted meanwhile, and those whose image is damaged or no longer accepted: the
        doctor names them.
        """
        ids: list[str] = []
        cursor: str | None = None
        while True:
            page, cursor = self._views.list(claim.map, Filters(), state="ready", cursor=cursor, limit=PAGE)
            ids += [view.id for view in page]
            if cursor is None:
                break
        chosen = np.random.default_rng(seed).permutation(len(ids))[: vocabularies.MOST_IMAGES]
        for done, number in enumerate(chosen):
            if stopping():
                raise JobStopped
            beat.report(JobProgress(done, len(chosen)))
            try:
                image = self._decode(self._views.image(ids[number]))
            except NotFound:  # it was deleted since they were listed
                continue
            except (BadImage, Damaged) as error:
                log.warning("the view %s is left out of a vocabulary: %s", ids[number], error.detail)
                continue
            yield self._scheduler.submit(image, field_alone, urgent=False).result().value


LOOK_EVERY_S = 20.0


class _Heartbeat:
    """Checks, in a thread of its own while its block runs, whether the job is still this worker's.

    Parameters
    ----------
    report : function
        Called with the progress; raises LeaseLost.
    """

    def __init__(self, report: Callable[[JobProgress], None]) -> None:
        self._report = report
        self._progress = JobProgress(0, 0)
        self._ended = threading.Event()
        self._lost: LeaseLost | None = None
        self._thread = threading.Thread(target=self._run, name="revisit-heartbeat", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def report(self, progress: JobProgress) -> None:
        """Report progress; raises LeaseLost."""
        if self._lost is not None:
            raise self._lost
        self._progress = progress
        self._report(progress)

    def _run(self) -> None:
        while not self._ended.wait(LOOK_EVERY_S):
            try:
                self._report(self._progress)
            except LeaseLost as lost:
                self._lost = lost
                return
            except (DiskFull, StorageFailed) as error:  # it is asked again
                log.debug("whether a job is still this worker's is not known: %s", error.detail)


def _now() -> datetime:
    return datetime.now(UTC)
