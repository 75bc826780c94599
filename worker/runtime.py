"""Everything that is running, in one place."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from schemas.image import Image
from schemas.ports import Encoder, Store
from schemas.recipe import Recipe
from schemas.settings import Settings
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler
from worker.loop import Loop
from worker.method.calibration import Calibration
from worker.search.catalogue import Catalogue
from worker.search.searcher import Searcher


@dataclass(frozen=True)
class Runtime:
    """The parts of a service, built by `worker.bootstrap` and started together.

    Parameters
    ----------
    decode, thumbnail, shrink : function
        Bytes to Picture; bytes and longest side to a JPEG; Picture to one small enough to keep.
    default_recipe : Recipe
        Of maps that are made by their first enrolment.
    loop : Loop or None
        None when other processes describe the pictures.
    calibration : function
        Recipe to what makes confidences of its scores.
    schema_version : str
        Of the database's tables.
    serving : bool
        Whether this is the one process that answers HTTP over the data folder.
    unlock : function
        Lets go of the data folder.
    """

    settings: Settings
    encoder: Encoder
    store: Store
    decode: Callable[[bytes], Image]
    thumbnail: Callable[[bytes, int], bytes]
    shrink: Callable[[Image], Image]
    scheduler: Scheduler
    describers: Describers
    catalogue: Catalogue
    searcher: Searcher
    loop: Loop | None
    default_recipe: Recipe
    calibration: Callable[[Recipe], Calibration]
    schema_version: str
    serving: bool
    unlock: Callable[[], None]

    def start(self) -> None:
        """Clean up after a crash, if there was one, and begin to work."""
        if self.serving:  # a worker must not forget the calls that the service beside it is answering
            self.store.recover(datetime.now(UTC))
        self.scheduler.start()
        if self.loop is not None:
            self.loop.start()

    def stop(self) -> None:
        """Finish what is under way, put the rest back, and let go of the data folder."""
        if self.loop is not None:
            self.loop.stop()
        self.scheduler.stop()
        self.store.close()
        self.unlock()
