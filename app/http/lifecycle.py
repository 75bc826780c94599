"""How the service is: starting, ready, stopping, and what it is made of."""

import asyncio
import platform
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
    """Starts and stops the house, and answers for it.

    Parameters
    ----------
    runtime : Runtime
    """

    def __init__(self, runtime: "Runtime") -> None:
        self._runtime = runtime
        self._started = False
        self._draining = False
        # A thread of its own: the answer must come while every other one works.
        self._thread = ThreadPoolExecutor(1, "revisit-condition")

    @property
    def started(self) -> bool:
        """Whether the house has been opened."""
        return self._started

    @property
    def draining(self) -> bool:
        """Whether the service is stopping."""
        return self._draining

    async def start(self) -> None:
        """Open the house."""
        await asyncio.to_thread(self._runtime.start)
        self._started = True

    async def stop(self) -> None:
        """Finish what is under way and close the house."""
        self._draining = True
        await asyncio.to_thread(self._runtime.stop)
        self._thread.shutdown()

    async def readiness(self) -> wire.Readiness:
        """What can be done at this moment. A map that cannot be served is named; the others are served."""
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
        """Pictures that wait to be described."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._runtime.store.jobs.count_waiting)

    async def version(self) -> wire.Version:
        """What is running."""
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
    """Versions of the libraries; read from disk, so only once."""
    return {name: version(name) for name in LIBRARIES}
