"""The worker's loop: claim images, describe them, store the descriptions; jobs of maps in a second thread."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol

from schemas.description import Description
from schemas.errors import Busy, LeaseLost, PoorImage, RevisitError
from schemas.image import Image
from schemas.log_context import bound
from schemas.recipe import DescriptionRecipe
from schemas.records import Claim, JobKind, MapClaim
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed
from worker.service.decoded import DecodedImages
from worker.service.giving_way import Rest
from worker.service.trouble import STORAGE_ERRORS, StoringTrouble

log = logging.getLogger("revisit.worker")

AHEAD = 2
"""Batches claimed ahead: one is decoded while the other is encoded."""

IDLE_S = 0.5
"""Seconds to sleep when no image waits; `Loop.wake` ends the sleep."""

PRUNE_EVERY_S = 5.0
"""Seconds between checks for unused descriptions."""

MAP_WORK_EVERY_S = 1.0
"""Seconds between checks for jobs of maps and for views to compare."""

MAP_PAUSE_S = 10.0
"""Most seconds between attempts of jobs of maps and comparisons while they cannot be stored."""

ATTEMPTS = 3
"""Attempts to describe an image, and to store its description, before an error that is not foreseen fails its job."""

RETRY_S = 1.0
"""Seconds before the second attempt to describe an image, and twice as many before the third."""

MAP_JOB_PATIENCE_S = 10.0
"""Seconds that `Loop.stop` waits for a job of a map to be put back."""

Decode = Callable[[bytes], Image]


@dataclass(frozen=True)
class _Underway:
    claim: Claim
    future: "Future[Timed[Description]]"
    refusals: list[Exception] = field(default_factory=list)  # what the store said to its description


class DescribeJobs(Protocol):
    """The queues of describe jobs and of jobs of maps."""

    def claim(self, worker: str, count: int, able: Callable[[DescriptionRecipe], bool]) -> list[Claim]:
        """Claim up to `count` of the oldest describe jobs whose recipe the worker is able to describe by."""
        ...

    def finish(self, claim: Claim, description: Description, now: datetime) -> int:
        """Store a description and end its job; returns the revision; raises LeaseLost."""
        ...

    def fail(self, claim: Claim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; raises LeaseLost."""
        ...

    def release(self, claim: Claim) -> None:
        """Put a job back without counting the attempt."""
        ...

    def try_again(self, claim: Claim) -> None:
        """Put a job back after an attempt that counts."""
        ...

    def take_back(self, worker: str, held: Collection[str], *, describe: bool) -> int:
        """Put back jobs of a worker, to describe or of maps, that it does not hold; returns how many."""
        ...

    def claim_map_job(self, worker: str, now: datetime, able: Callable[[DescriptionRecipe], bool]) -> MapClaim | None:
        """Claim the oldest waiting job of a map that needs no recipe which the worker cannot describe by."""
        ...


class ImageReader(Protocol):
    """Enrolled images."""

    def image(self, view_id: str) -> bytes:
        """The enrolled bytes; raises NotFound."""
        ...


class Pruning(Protocol):
    """Descriptions, recipes and vocabularies that no map uses."""

    def prune(self) -> int:
        """Remove a portion of them; returns how many descriptions, 0 when none is left."""
        ...


class Loop:
    """Describes enrolled images until it is stopped.

    Jobs of maps run in a thread of their own, so that enrolments do not wait for them.

    Parameters
    ----------
    jobs, views, pruning
        Parts of the store.
    scheduler : Scheduler
    describers : Describers
    map_jobs : mapping of kind to function
        Does a job of a map; its second argument returns whether to stop.
    compare : function
        Compares a portion of views with the others of their map, and returns whether there was anything to do; its
        arguments say whether images wait to be described, and how to rest until a job of a map waits.
    decode : function
        Bytes to Image; raises BadImage.
    decoded : DecodedImages
        Images that need not be read and decoded again.
    name : str
        Of this worker, written to its claims.
    batch : int
        Images encoded together.
    refused : function
        Why the image of a job is refused, by its description, in words; None when it is not.
    trouble : StoringTrouble
        Is told when descriptions cannot be stored. They are kept and tried again until they can.
    """

    def __init__(
        self,
        *,
        jobs: DescribeJobs,
        views: ImageReader,
        pruning: Pruning,
        scheduler: Scheduler,
        describers: Describers,
        map_jobs: Mapping[JobKind, Callable[[MapClaim, Callable[[], bool]], None]],
        compare: Callable[[bool, Rest], bool] = lambda busy, rest: False,
        decode: Decode,
        decoded: DecodedImages,
        name: str,
        batch: int,
        trouble: StoringTrouble,
        refused: Callable[[Claim, Description], str | None] = lambda claim, description: None,
    ) -> None:
        self._jobs, self._views, self._pruning = jobs, views, pruning
        self._scheduler = scheduler
        self._describers = describers
        self._map_jobs, self._compare = map_jobs, compare
        self._decode, self._decoded, self._refused = decode, decoded, refused
        self._name = name
        self._batch = batch
        self._trouble = trouble
        self._map_trouble = StoringTrouble("comparisons and what is learned of maps", MAP_PAUSE_S)
        self._awake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.run, name="revisit-worker", daemon=True)
        self._map_thread = threading.Thread(target=self._run_map_jobs, name="revisit-map-jobs", daemon=True)
        self._map_awake = threading.Event()
        self._idle = threading.Event()
        self._pruned = -PRUNE_EVERY_S  # when there was nothing left to prune, of a monotonic clock
        self._on_finish: list[Callable[[str], None]] = []

    def on_finish(self, notify: Callable[[str], None]) -> None:
        """Call `notify`, in the worker's thread, with the id of each view that was described or failed."""
        self._on_finish.append(notify)

    @property
    def alive(self) -> bool:
        """Whether the thread for describe jobs runs."""
        return self._thread.is_alive()

    @property
    def whole(self) -> bool:
        """Whether the thread for jobs of maps runs as well."""
        return self.alive and self._map_thread.is_alive()

    def start(self) -> None:
        """Start the threads for describe jobs and for jobs of maps."""
        self._thread.start()
        self._map_thread.start()

    def wake(self) -> None:
        """Look for images to describe at once."""
        self._awake.set()

    def wake_all(self) -> None:
        """Look for images to describe and for jobs of maps at once."""
        self.wake()
        self._map_awake.set()

    def stop(self) -> None:
        """Finish the images that are being encoded, put the other jobs back, and stop."""
        self._stopping.set()
        self.wake_all()
        if self._thread.is_alive():
            self._thread.join()
        if self._map_thread.is_alive():  # a job in a long step goes back when this worker signs off
            self._map_thread.join(MAP_JOB_PATIENCE_S)

    def leave(self) -> None:
        """Claim no more, and put all jobs back without counting the attempts; waits for nothing that may hang."""
        self._stopping.set()
        try:
            for describe in (True, False):
                self._jobs.take_back(self._name, (), describe=describe)
        except RevisitError as error:
            log.warning("this worker's jobs go back once its lease has ended: %s", error)

    def run(self) -> None:
        """Describe images until `stop`; an error with one image fails that image's job, never the loop."""
        underway: list[_Underway] = []

        def take_back() -> None:
            self._jobs.take_back(self._name, [item.claim.job_id for item in underway], describe=True)

        self._repeat(lambda: self._describe_next(underway), take_back, self._trouble)
        for item in underway:
            self._put_back(item)

    def _repeat(self, step: Callable[[], None], take_back: Callable[[], object], trouble: StoringTrouble) -> None:
        """Do a step again and again until `stop`.

        After a failure jobs may be claimed that this worker does not know of: `take_back` puts them back.
        """
        unsure = False
        while not self._stopping.is_set():
            try:
                if unsure:
                    take_back()
                    unsure = False
                step()
            except STORAGE_ERRORS as error:
                unsure = True
                self._stopping.wait(trouble.begins(error))
            except Exception:
                log.exception("the worker goes on after a failure of its own")
                unsure = True
                self._stopping.wait(IDLE_S)

    def _describe_next(self, underway: list[_Underway]) -> None:
        """Claim jobs, and settle the first of those under way; where there is none, wait until there may be."""
        if self._trouble.error is None or not underway:
            self._take(AHEAD * self._batch - len(underway), underway)
        if underway:
            self._idle.clear()
            with _log_fields(underway[0].claim):
                self._settle(underway[0])
            underway.pop(0)
        else:
            self._trouble.ends()  # looking for jobs, which needs the store, went well
            self._decoded.clear()
            self._idle.set()
            self._awake.wait(IDLE_S)
            self._awake.clear()

    def _put_back(self, item: _Underway) -> None:
        """When the loop stops: release a job that has not begun, else store its description if that is possible."""
        try:
            if item.future.cancel():
                self._jobs.release(item.claim)
            else:
                with _log_fields(item.claim):
                    self._settle(item)
        except Exception as error:  # without this worker's signs of life the job goes back to the queue
            log.warning("job %s is left to the next worker: %s", item.claim.job_id, error)

    def _run_map_jobs(self) -> None:
        """Run jobs of maps; when none waits, compare views and prune; until `stop`."""
        self._repeat(
            self._work_on_maps, lambda: self._jobs.take_back(self._name, (), describe=False), self._map_trouble
        )

    def _work_on_maps(self) -> None:
        """Run a job of a map, or prune, or compare views."""
        claim = self._jobs.claim_map_job(self._name, _now(), self._describers.has)
        if claim is not None:
            with bound(job_id=claim.job_id, map=claim.map):
                self._map_jobs[claim.kind](claim, self._stopping.is_set)
            return
        if time.monotonic() - self._pruned >= PRUNE_EVERY_S:
            if self._pruning.prune():
                return
            self._pruned = time.monotonic()
        compared = self._compare(not self._idle.is_set(), self._map_awake.wait)
        self._map_trouble.ends()
        if not compared:
            self._map_awake.wait(MAP_WORK_EVERY_S)
        self._map_awake.clear()

    def _take(self, count: int, underway: list[_Underway]) -> None:
        """Claim up to `count` jobs and begin them; each is added to `underway`, even if others fail to begin."""
        if count <= 0:
            return
        claims, unread = self._jobs.claim(self._name, count, self._describers.has), []
        for claim in claims:
            with _log_fields(claim):
                try:
                    image = self._decoded.take(claim.view.image.sha256)
                    if image is None:
                        image = self._decode(self._views.image(claim.view.id))
                    describer = self._describers.of(claim.recipe)
                    future = describer.submit(self._scheduler, image, urgent=False)
                except Exception as error:
                    future = Future()
                    future.set_exception(error)
                    if isinstance(error, STORAGE_ERRORS):
                        unread.append(error)
            underway.append(_Underway(claim, future))
        if unread and len(unread) == len(claims):
            raise unread[-1]

    def _settle(self, item: _Underway) -> None:
        """Wait for the description of a job and store it, or end the job as failed; raises what storing raises."""
        try:
            description = item.future.result().value
        except (Busy, *STORAGE_ERRORS):
            # The service stops (else the scheduler would have waited for the encoder), or the image cannot be read or
            # decoded now: none of them is a fault of the view.
            self._jobs.release(item.claim)
            self._stopping.wait(IDLE_S)
            return
        except RevisitError as error:
            self._give_up(item.claim, error)
            return
        except Exception as error:
            if item.claim.attempts >= ATTEMPTS:
                self._give_up(item.claim, error)
            else:  # as for want of memory
                log.warning("view %s could not be described; it is tried again", item.claim.view.id, exc_info=error)
                self._jobs.try_again(item.claim)
                self._stopping.wait(RETRY_S * item.claim.attempts)
            return
        try:
            poor = self._refused(item.claim, description)
            if poor is None:
                self._jobs.finish(item.claim, description, _now())
            else:
                self._jobs.fail(item.claim, PoorImage.code, poor, _now())
                log.info("view %s is refused: %s", item.claim.view.id, poor, extra={"event": "refused"})
        except LeaseLost:
            log.info("job %s was given to another worker, or its view was deleted", item.claim.job_id)
        except STORAGE_ERRORS:
            raise
        except Exception as error:
            item.refusals.append(error)
            if len(item.refusals) < ATTEMPTS:
                raise
            self._give_up(item.claim, error)
            return
        self._trouble.ends()
        self._notify(item.claim)

    def _give_up(self, claim: Claim, error: Exception) -> None:
        """End a job as failed because of an error, which is logged."""
        if isinstance(error, RevisitError):
            code, detail = error.code, error.detail
            failed = {"event": "describe_failed", "problem": code}
            log.warning("view %s could not be described: %s", claim.view.id, code, extra=failed)
        else:
            log.error("view %s could not be described", claim.view.id, exc_info=error)
            code, detail = (
                "internal",
                f"describing it failed ({type(error).__name__}); the service's log has the details",
            )
        try:
            self._jobs.fail(claim, code, detail, _now())
        except LeaseLost:
            log.info("job %s was given to another worker, or its view was deleted", claim.job_id)
        self._trouble.ends()
        self._notify(claim)

    def _notify(self, claim: Claim) -> None:
        """Call the functions of `on_finish`."""
        for notify in self._on_finish:
            notify(claim.view.id)


def _log_fields(claim: Claim) -> AbstractContextManager[None]:
    """Gives log lines of a block the ids of a describe job and its view."""
    return bound(job_id=claim.job_id, view_id=claim.view.id)


def _now() -> datetime:
    return datetime.now(UTC)
