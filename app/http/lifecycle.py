"""The state of the service: starting, ready or stopping, and the versions of its parts."""

import asyncio
import platform
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from app.http.readiness import ReadinessCheck
from app.http.statistics import StatisticsReader
from app.version import VERSION
from schemas import wire
from schemas.statistics import LiveStatistics, ServiceStatistics
from schemas.threads import Threads
from worker.service.comparing import SAMPLE
from worker.service.statistics import StatisticsService

if TYPE_CHECKING:
    from worker.runtime import Runtime

LIBRARIES = ("onnxruntime", "torch", "faiss-cpu", "numpy", "opencv-python-headless", "fastapi", "sqlalchemy")


class Lifecycle:
    """Starts and stops the runtime, and reports its state.

    Parameters
    ----------
    runtime : Runtime
    """

    def __init__(self, runtime: "Runtime") -> None:
        self._runtime = runtime
        self._check = ReadinessCheck(runtime)
        self._started = False
        self._draining = False
        self._on_drain: list[Callable[[], None]] = []
        # A thread of its own: the probes must be answered while all other threads are busy.
        self._thread = Threads(1, "revisit-lifecycle")
        gather = StatisticsService(
            store=lambda: runtime.store.statistics(datetime.now(UTC), SAMPLE),
            indexes=runtime.catalogue,
            data=runtime.settings.data,
            heartbeat_ages=lambda: runtime.attendance.ages_s(),
        ).gather
        self._statistics = StatisticsReader(gather)

    @property
    def started(self) -> bool:
        """Whether the runtime has started."""
        return self._started

    @property
    def draining(self) -> bool:
        """Whether the service is stopping."""
        return self._draining

    async def start(self) -> None:
        """Start the runtime."""
        await asyncio.to_thread(self._runtime.start)
        self._started = True
        self._check.begin()  # under load its first result would be late, and whoever asks first be told "not ready"

    def on_drain(self, call: Callable[[], None]) -> None:
        """Have `call` called, on the event loop, when the service begins to stop."""
        self._on_drain.append(call)

    def drain(self) -> None:
        """Begin to stop: requests under way are finished, new ones are refused, and those that wait are woken."""
        if self._draining:
            return
        self._draining = True
        for call in self._on_drain:
            call()

    async def stop(self) -> None:
        """Finish the work under way and stop the runtime."""
        self.drain()
        await self._check.close()
        await asyncio.to_thread(self._runtime.stop)
        self._thread.shutdown()
        self._statistics.close()

    def beyond_help(self) -> str | None:
        """What only a restart mends, in words; None while there is nothing of the kind."""
        if not self._started or self._draining:
            return None
        if self._runtime.scheduler.away is not None:
            self._check.begin()  # nobody may send an image, which alone would tell whether it is so still
        return self._runtime.beyond_help

    async def readiness(self) -> wire.Readiness:
        """Whether the service can enrol and answer now, and the state of each part."""
        return await self._check.current()

    def live(self) -> LiveStatistics:
        """What the metrics show and is known without asking the database."""
        loop, scheduler = self._runtime.loop, self._runtime.scheduler
        working = None if loop is None else loop.alive
        waiting = self._runtime.services.query.outside + scheduler.queries_waiting
        return LiveStatistics(waiting, scheduler.alive, working, decoder_restarts=self._runtime.decoder.restarts)

    async def statistics(self) -> tuple[ServiceStatistics | None, float]:
        """What the metrics show of database and disk (None before the first), and its age in seconds; never hangs."""
        return await self._statistics.read()

    async def version(self) -> wire.Version:
        """Versions of the service, its encoder and its libraries."""
        runtime = self._runtime
        return wire.Version(
            version=VERSION,
            encoder=runtime.encoder.name,
            weights=runtime.encoder.digest,
            terms=runtime.encoder.terms,
            preset=runtime.settings.preset,
            schema_version=runtime.schema_version,
            python=platform.python_version(),
            libraries=_installed(),
        )


@cache
def _installed() -> dict[str, str]:
    """Versions of the libraries, read from disk once."""
    found = {}
    for name in LIBRARIES:
        with suppress(PackageNotFoundError):  # torch, in a slim installation
            found[name] = version(name)
    return found
