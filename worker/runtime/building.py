"""Builds a service from its settings, and starts and stops it as a whole."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial

from schemas.image import Image
from schemas.recipe import MapRecipe
from schemas.settings import Settings
from worker.configure import configure
from worker.description.map_training import VocabularyTrainer
from worker.description.presets import Wanted, make_recipe
from worker.description.scheduler import Scheduler
from worker.encoders.choosing import batch_of, make_encoder
from worker.encoders.cores import usable_cores
from worker.images import quality
from worker.loop import Loop
from worker.method.calibration import Calibration
from worker.runtime.parts import MakeEncoder, Parts, make_parts
from worker.runtime.services import Services, make_services
from worker.service.attendance import Attendance, this_process
from worker.service.calibrations import shipped_calibration
from worker.service.gate import QualityGate
from worker.service.importing import Importer
from worker.service.recordings import Limits
from worker.service.tending import idle_work
from worker.service.trouble import StoringTrouble
from worker.storage.locks import lock_for_serving
from worker.storage.migrating import newest


@dataclass(frozen=True)
class Runtime(Parts):
    """The parts of a process and what is built of them, made by `build` and started together.

    Parameters
    ----------
    loop : Loop or None
        None when only other processes describe images.
    attendance : Attendance
        Knows which workers are alive.
    services : Services
    default_recipe : MapRecipe
        Recipe of a map that its first enrolment creates.
    calibration : function
        Recipe to the calibration shipped for it.
    schema_version : str
        Revision of the database's tables.
    serving : bool
        True for the one process that serves the data folder over HTTP, False for a worker.
    unlock : function
        Releases the data folder.
    """

    loop: Loop | None
    attendance: Attendance
    services: Services
    default_recipe: MapRecipe
    calibration: Callable[[MapRecipe], Calibration]
    schema_version: str
    serving: bool
    unlock: Callable[[], None]

    def start(self) -> None:
        """Clean up after a crash, then start the schedulers and the loop."""
        alone = self.serving and self.store.recover()  # a worker would delete the calls that the service is answering
        self.decoder.start()
        self.attendance.start(alone=alone)
        for scheduler in self._schedulers:
            scheduler.start()
        if self.loop is not None:
            self.loop.start()
        self.bell.start(waits=self.serving)

    @property
    def beyond_help(self) -> str | None:
        """What only a restart mends while this process runs, in words; None while there is nothing of the kind."""
        if self.loop is not None and not self.loop.whole:
            return "a thread of the worker has ended"
        # A segmenter that fails alone fails drawings: queries go on.
        return self.scheduler.beyond_help or (self.segmenting.stuck if self.segmenting is not None else None)

    @property
    def _schedulers(self) -> list[Scheduler]:
        return [one for one in (self.scheduler, self.segmenting) if one is not None]

    def leave(self) -> None:
        """Put jobs back and sign off, before the process ends without `stop`: what that waits for may hang."""
        if self.loop is not None:
            self.loop.leave()
        self.attendance.stop()

    def decode(self, data: bytes) -> Image:
        """Bytes to Image; raises BadImage."""
        return self.decoder.decode(data)

    def stop(self) -> None:
        """Finish running work, put waiting jobs back, and release the data folder."""
        for scheduler in self._schedulers:
            scheduler.stop_waiting()
        if self.loop is not None:
            self.loop.stop()
        self.attendance.stop()
        self.bell.stop()
        for scheduler in self._schedulers:
            scheduler.stop()
        self.decoder.close()
        self.services.query.scores.stop()
        self.catalogue.close()
        self.store.close()
        self.unlock()


def build(
    settings: Settings,
    *,
    serving: bool = True,
    make_encoder: MakeEncoder = make_encoder,
    make_scheduler: type[Scheduler] = Scheduler,
) -> Runtime:
    """Build everything, start nothing.

    Parameters
    ----------
    settings : Settings
    serving : bool
        True for the one process that serves the data folder over HTTP; False for a worker.
    make_encoder : function
        Another one for benchmarks with other encoders.
    make_scheduler : type of Scheduler
        Another one for studies that describe the same images for many maps.

    Raises
    ------
    SetupError
        The data folder is in use, the database is newer than this program, the images are of another database, or
        the encoder cannot be loaded.
    """
    threads = settings.threads or usable_cores()
    configure(threads)
    settings.data.mkdir(parents=True, exist_ok=True)
    unlock = lock_for_serving(settings.data, datetime.now(UTC)).release if serving else _nothing
    try:
        describes = settings.inline_worker or not serving
        parts = make_parts(
            settings, threads, describes=describes, make_encoder=make_encoder, make_scheduler=make_scheduler
        )
        me = this_process("serve" if serving else "worker", f"{parts.encoder.name} {parts.encoder.digest[:12]}")
        loop = _make_loop(parts, me.name) if describes else None
        attendance = Attendance.of(parts.store, me, loop, settings.lease_s)
        if loop is not None:
            parts.bell.hang(loop)
        default_recipe = make_recipe(parts.encoder, Wanted(), preset=settings.preset)
        return Runtime(
            **vars(parts),
            loop=loop,
            attendance=attendance,
            services=make_services(parts, attendance, default_recipe),
            default_recipe=default_recipe,
            calibration=shipped_calibration,
            schema_version=newest(),
            serving=serving,
            unlock=unlock,
        )
    except BaseException:
        unlock()
        raise


def _make_loop(parts: Parts, name: str) -> Loop:
    """The loop of a process that describes images and does jobs of maps; `name` is that of the worker."""
    settings, store, decoder = parts.settings, parts.store, parts.decoder
    stored = partial(decoder.decode, patient=True, stored=True)
    trainer = VocabularyTrainer(
        maps=store.maps, views=store.views, jobs=store.jobs, describers=parts.describers, scheduler=parts.scheduler,
        decode=stored,
    )  # fmt: skip
    importer = Importer(
        uploads=store.uploads, jobs=store.jobs, removals=store.removals, enrolment=parts.enrolment,
        settlements=parts.settlements, decode=partial(decoder.decode, patient=True), read_exif=decoder.read_exif,
        look_for_problem=quality.problem_of, limits=Limits.of(settings),
        ahead_bytes=settings.handed_on_pixel_bytes // 2, wake=parts.bell.ring,
    )  # fmt: skip
    return Loop(
        jobs=store.jobs, views=store.views, pruning=store.pruning, scheduler=parts.scheduler,
        describers=parts.describers,
        map_jobs={
            "vocabulary": trainer.run, "snapshot": parts.snapshots.run, "import": importer.run,
            "shadow": parts.shadows.run,
        },
        compare=idle_work(store.leftovers, store.indexing, parts.comparer if settings.compare else None),
        decode=stored, decoded=parts.decoded, name=name, batch=batch_of(settings),
        trouble=StoringTrouble("descriptions", 2.0, parts.settlements.refuse),
        refused=QualityGate(parts.duplicates).problem_of,
    )  # fmt: skip


def _nothing() -> None:
    """Does nothing: a worker has no serving lock to release."""
