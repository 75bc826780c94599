"""Readiness: whether images can be enrolled and queries answered now, found out by trying; and liveness.

A check takes as long as its slowest part, an image through the encoder. It runs in a thread of its own, and only when
somebody asks; whoever asks meanwhile gets the last result with its age.
"""

import asyncio
import time
from concurrent.futures import Future
from typing import TYPE_CHECKING

from starlette.responses import Response

from schemas import wire
from schemas.errors import RevisitError
from schemas.threads import Threads
from worker.description.trial import tried

if TYPE_CHECKING:
    from worker.runtime import Runtime

FRESH_S = 2.0
"""Seconds for which a result is given without another check: probes are cheap."""

PATIENCE_S = 0.15
"""Seconds that a caller waits for a check, before it gets the last result."""

BAD_PATIENCE_S = 0.3
"""The same where that result says not ready, or there is none: it may be long over. Probes wait a second at least."""

STALE_S = 30.0
"""Seconds after which a check that has not ended makes the service not ready."""

END_S = 1.0
"""Seconds that a service which stops waits for a check."""

ENCODER_PATIENCE_S = 5.0
"""Seconds in which the encoder has to answer the test image or another one."""


def liveness(trouble: str | None) -> Response:
    """What ``/livez`` answers; `trouble`: what only a restart mends, in words, or None."""
    if trouble is None:
        return Response("ok\n", media_type="text/plain")
    return Response(f"{trouble}; restart it\n", 503, media_type="text/plain")


class ReadinessCheck:
    """Checks the parts of a runtime.

    Parameters
    ----------
    runtime : Runtime
    """

    def __init__(self, runtime: "Runtime") -> None:
        self._runtime = runtime
        self._thread = Threads(1, "revisit-readiness")
        self._last: tuple[float, wire.Readiness] | None = None
        self._running: Future[wire.Readiness] | None = None
        self._began = 0.0

    async def current(self) -> wire.Readiness:
        """The result of a check at most `FRESH_S` old, or the last one with its age, within `BAD_PATIENCE_S`."""
        if self._last is not None and time.monotonic() - self._last[0] < FRESH_S:
            return self._aged(self._last)
        running = self.begin()
        patience_s = PATIENCE_S if self._last is not None and self._last[1].ready else BAD_PATIENCE_S
        await asyncio.wait([asyncio.wrap_future(running)], timeout=patience_s)
        lasted = time.monotonic() - self._began
        if self._last is None or (lasted >= STALE_S and not running.done()):
            checks = {} if self._last is None else self._last[1].checks
            late = {"service": f"the check that began {lasted:.1f} s ago has not ended"}
            return wire.Readiness(ready=False, checks=late | checks)
        return self._aged(self._last)

    def begin(self) -> Future[wire.Readiness]:
        """Begin a check, unless one is under way; returns that one."""
        if self._running is None or self._running.done():
            self._began = time.monotonic()
            self._running = self._thread.submit(self._check)
        return self._running

    async def close(self) -> None:
        """End the thread; a check under way has `END_S` to end, for it reads the database."""
        if self._running is not None:
            await asyncio.wait([asyncio.wrap_future(self._running)], timeout=END_S)
        self._thread.shutdown(wait=False)

    @staticmethod
    def _aged(last: tuple[float, wire.Readiness]) -> wire.Readiness:
        made, readiness = last
        return readiness.model_copy(update={"age_s": round(time.monotonic() - made, 1)})

    def _check(self) -> wire.Readiness:
        try:
            readiness = self._look()
        except Exception as error:
            readiness = wire.Readiness(ready=False, checks={"service": f"the check failed ({type(error).__name__})"})
        self._last = time.monotonic(), readiness
        return readiness

    def _look(self) -> wire.Readiness:
        store = self._runtime.store
        needed = {
            "database": store.check(),
            "disk": self._disk(),
            "decoder": self._runtime.decoder.check(),
            "encoder": tried(self._runtime.scheduler, ENCODER_PATIENCE_S),
            "worker": self._worker(),
        }
        if store.vectors is not None and needed["database"] == "ok":
            needed["index"] = store.vectors.check()
        maps = self._maps() if needed["database"] == "ok" else {}
        broken = {f"map {name}": found.state for name, found in maps.items() if found.state != "ok"}
        ready = all(state == "ok" for state in needed.values())
        return wire.Readiness(ready=ready, checks=needed | broken, maps=maps)

    def _disk(self) -> str:
        state = self._runtime.store.check_space()
        trouble = self._runtime.settlements.trouble  # callers that wait are refused until the worker has tried again
        return trouble.detail if state == "ok" and trouble is not None else state

    def _worker(self) -> str:
        runtime = self._runtime
        nobody = runtime.attendance.nobody
        if nobody is None or runtime.loop is None:
            return nobody or "ok"
        return "its thread has ended; restart the service"

    def _maps(self) -> dict[str, wire.MapReadiness]:
        indexed, recalls = self._runtime.catalogue.revisions(), self._runtime.catalogue.recalls()
        found = {}
        for record in self._runtime.store.maps.all():
            state = "ok"
            try:
                self._runtime.describers.of(record.description)
            except RevisitError as error:
                state = error.detail
            found[record.name] = wire.MapReadiness(
                state=state,
                revision=record.revision,
                indexed=indexed.get(record.name),
                recall=recalls.get(record.name),
            )
        return found
