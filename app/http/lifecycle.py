"""How the service is: starting, ready, stopping, and what it is made of."""

import asyncio
import platform
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.metadata import version

from app.version import VERSION
from schemas import wire
from schemas.errors import RevisitError
from worker.runtime import House

LIBRARIES = ("onnxruntime", "torch", "faiss-cpu", "numpy", "opencv-python-headless", "fastapi", "sqlalchemy")


class Condition:
    """Starts and stops the house, and answers for it.

    Parameters
    ----------
    house : House
    """

    def __init__(self, house: House) -> None:
        self._house = house
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
        await asyncio.to_thread(self._house.start)
        self._started = True

    async def stop(self) -> None:
        """Finish what is under way and close the house."""
        self._draining = True
        await asyncio.to_thread(self._house.stop)
        self._thread.shutdown()

    async def readiness(self) -> wire.Readiness:
        """What can be done at this moment. A map that cannot be served is named; the others are served."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._readiness)

    def _readiness(self) -> wire.Readiness:
        house = self._house
        needed = {
            "database": house.store.check(),
            "encoder": "ok" if house.desk.alive else "its thread has ended; restart the service",
        }
        if house.loop is not None:
            needed["worker"] = "ok" if house.loop.alive else "its thread has ended; restart the service"
        maps = {}
        if needed["database"] == "ok":
            for record in house.store.maps():
                try:
                    house.describers.of(record.recipe)
                except RevisitError as error:
                    maps[f"map {record.name}"] = error.detail
        return wire.Readiness(ready=all(state == "ok" for state in needed.values()), checks=needed | maps)

    async def queue_length(self) -> int:
        """Pictures that wait to be described."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._house.store.waiting)

    async def version(self) -> wire.Version:
        """What is running."""
        house = self._house
        return wire.Version(
            version=VERSION,
            encoder=house.encoder.name,
            weights=house.encoder.digest,
            preset=house.settings.preset,
            schema_version=house.schema_version,
            python=platform.python_version(),
            libraries=_installed(),
        )


@cache
def _installed() -> dict[str, str]:
    """Versions of the libraries; read from disk, so only once."""
    return {name: version(name) for name in LIBRARIES}
