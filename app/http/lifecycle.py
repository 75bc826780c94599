"""The state of the service: starting, ready or stopping, and the versions of its parts."""

import asyncio
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.metadata import version
from typing import TYPE_CHECKING

from app.version import VERSION
from schemas import wire
from schemas.errors import RevisitError

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
        self._started = False
        self._draining = False
        self._on_drain: list[Callable[[], None]] = []
        # A thread of its own: the probes must be answered while all other threads are busy.
        self._thread = ThreadPoolExecutor(1, "revisit-lifecycle")

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
        await asyncio.to_thread(self._runtime.stop)
        self._thread.shutdown()

    async def readiness(self) -> wire.Readiness:
        """Checks of the database, the encoder, the worker, and of each map that cannot be served (the others are)."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._readiness)

    def _readiness(self) -> wire.Readiness:
        runtime = self._runtime
        needed = {
            "database": runtime.store.check(),
            "encoder": "ok" if runtime.scheduler.alive else "its thread has ended; restart the service",
        }
        if runtime.loop is not None:
            needed["worker"] = "ok" if runtime.loop.alive else "its thread has ended; restart the service"
        maps = {}
        if needed["database"] == "ok":
            for record in runtime.store.maps.all():
                try:
                    runtime.describers.of(record.description)
                except RevisitError as error:
                    maps[f"map {record.name}"] = error.detail
        return wire.Readiness(ready=all(state == "ok" for state in needed.values()), checks=needed | maps)

    async def queue_length(self) -> int:
        """Number of images that wait to be described."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._runtime.store.jobs.count_waiting)

    async def version(self) -> wire.Version:
        """Versions of the service, its encoder and its libraries."""
        runtime = self._runtime
        return wire.Version(
            version=VERSION,
            encoder=runtime.encoder.name,
            weights=runtime.encoder.digest,
            preset=runtime.settings.preset,
            schema_version=runtime.schema_version,
            python=platform.python_version(),
            libraries=_installed(),
        )


@cache
def _installed() -> dict[str, str]:
    """Versions of the libraries, read from disk once."""
    return {name: version(name) for name in LIBRARIES}
