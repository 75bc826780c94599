"""The worker's loop: claim a picture, have it described, keep the description."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from schemas.description import Description
from schemas.errors import LeaseLost, RevisitError
from schemas.image import Image
from schemas.ports import Store
from schemas.records import Claim
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed

log = logging.getLogger("revisit.worker")

AHEAD = 2
"""Batches claimed at a time: one is decoded while the other is encoded."""

Decode = Callable[[bytes], Image]


@dataclass(frozen=True)
class _Underway:
    claim: Claim
    future: "Future[Timed[Description]]"


class Loop:
    """Describes enrolled pictures until it is stopped.

    Parameters
    ----------
    store : Store
    scheduler : Scheduler
    describers : Describers
    decode : function
        Bytes to Picture; raises BadPicture.
    name : str
        Of this worker, for the leases.
    batch : int
    lease : timedelta
    idle_s : float
        How long to sleep when nothing waits; `wake` ends a sleep.
    """

    def __init__(
        self,
        store: Store,
        scheduler: Scheduler,
        describers: Describers,
        decode: Decode,
        *,
        name: str,
        batch: int,
        lease: timedelta,
        idle_s: float = 0.5,
    ) -> None:
        self._store = store
        self._scheduler = scheduler
        self._describers = describers
        self._decode = decode
        self._name = name
        self._batch = batch
        self._lease = lease
        self._idle_s = idle_s
        self._awake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.run, name="revisit-worker", daemon=True)
        self._on_finish: list[Callable[[str], None]] = []

    def on_finish(self, notify: Callable[[str], None]) -> None:
        """Call `notify` with the id of each view whose description is settled, in the worker's thread."""
        self._on_finish.append(notify)

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Run in a thread of its own."""
        self._thread.start()

    def wake(self) -> None:
        """Look for work at once."""
        self._awake.set()

    def stop(self) -> None:
        """Finish what is being encoded, put the rest back, and stop."""
        self._stopping.set()
        self._awake.set()
        if self._thread.is_alive():
            self._thread.join()

    def run(self) -> None:
        """Work until `stop`; what goes wrong with one picture is that picture's failure, never the loop's."""
        underway: list[_Underway] = []
        while not self._stopping.is_set():
            try:
                underway += self._take(AHEAD * self._batch - len(underway))
                if underway:
                    self._settle(underway.pop(0))
                else:
                    self._awake.wait(self._idle_s)
                    self._awake.clear()
            except Exception:
                log.exception("the worker goes on after a failure of its own")
                self._stopping.wait(self._idle_s)
        for item in underway:
            if item.future.cancel():
                self._store.release(item.claim)
            else:
                self._settle(item)

    def _take(self, count: int) -> list[_Underway]:
        if count <= 0:
            return []
        taken = []
        for claim in self._store.claim(self._name, count, self._lease, _now()):
            try:
                image = self._decode(self._store.image(claim.view.id))
                describer = self._describers.of(claim.recipe)
                future = self._scheduler.submit(image, describer.describe, urgent=False, parallel=describer.keypoints)
                taken.append(_Underway(claim, future))
            except Exception as error:
                self._give_up(claim, error)
        return taken

    def _settle(self, item: _Underway) -> None:
        try:
            description = item.future.result().value
        except Exception as error:
            self._give_up(item.claim, error)
            return
        try:
            self._store.finish(item.claim, description, _now())
        except LeaseLost:
            log.info("job %s was given to another worker, or its view was deleted", item.claim.job_id)
        self._tell(item.claim)

    def _give_up(self, claim: Claim, error: Exception) -> None:
        if isinstance(error, RevisitError):
            code, detail = error.code, error.detail
        else:
            log.error("view %s could not be described", claim.view.id, exc_info=error)
            code, detail = (
                "internal",
                f"describing it failed ({type(error).__name__}); the service's log has the details",
            )
        try:
            self._store.fail(claim, code, detail, _now())
        except LeaseLost:
            log.info("job %s was given to another worker, or its view was deleted", claim.job_id)
        self._tell(claim)

    def _tell(self, claim: Claim) -> None:
        for notify in self._on_finish:
            notify(claim.view.id)


def _now() -> datetime:
    return datetime.now(UTC)
