"""Builds all parts of a service from its settings; the only module that names adapters."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from schemas.image import Image
from schemas.recipe import MapRecipe
from schemas.settings import MEGA, Settings
from worker.configure import configure
from worker.description.describers import Describers
from worker.description.map_training import VocabularyTrainer
from worker.description.ports import Encoder, Segmenter
from worker.description.presets import PRESETS, Wanted, general_vocabulary, make_recipe
from worker.description.scheduler import Scheduler
from worker.encoders.choosing import batch_of, make_encoder
from worker.images import codec, quality
from worker.images.apart.pool import make_decoder
from worker.images.decoder import Decoder
from worker.loop import Loop
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.search.byte_product import make_product
from worker.search.choosing import make_catalogue
from worker.search.flat_index import FlatIndex
from worker.search.ports import Catalogue, Selecting
from worker.service.ageing import AgeingPlaces
from worker.service.attendance import Attendance, this_process
from worker.service.bell import Bell
from worker.service.blurring import Blurring, BlurringEnrolment
from worker.service.calibrating import CalibrationService
from worker.service.calibrations import calibration_of, shipped_calibration
from worker.service.changes import ChangeService
from worker.service.comparing import MapComparer
from worker.service.day_scores import ScoreKeeper
from worker.service.decoded import DecodedImages
from worker.service.drives import Drives
from worker.service.duplicates import NearDuplicates
from worker.service.enroll import EnrollService
from worker.service.explanations import Explanations
from worker.service.gate import QualityGate
from worker.service.health import HealthService
from worker.service.import_receiving import ImportService
from worker.service.importing import Importer
from worker.service.inbox import InboxService
from worker.service.jobs import JobService
from worker.service.keeping import QueryKeeper
from worker.service.keys import KeyService
from worker.service.maps import MapService
from worker.service.proposals import ProposalService
from worker.service.query import QueryService
from worker.service.recordings import Limits
from worker.service.renderings import RenderingService
from worker.service.resemblances import Resemblances
from worker.service.searching import Searcher
from worker.service.settlements import Settlements
from worker.service.shadows import ShadowService
from worker.service.snapshots import SnapshotService
from worker.service.tending import idle_work
from worker.service.trouble import StoringTrouble
from worker.service.views import ViewService
from worker.storage.locks import lock_for_serving
from worker.storage.migrating import newest
from worker.storage.store import SqlStore, open_store


@dataclass(frozen=True)
class Services:
    """The use-cases."""

    enroll: EnrollService
    query: QueryService
    searcher: Searcher
    views: ViewService
    renderings: RenderingService
    changes: ChangeService
    maps: MapService
    jobs: JobService
    calibration: CalibrationService
    health: HealthService
    inbox: InboxService
    proposals: ProposalService
    keys: KeyService
    snapshots: SnapshotService
    shadows: ShadowService
    imports: ImportService


@dataclass(frozen=True)
class Runtime:
    """The parts of a service, built by `build` and started together.

    Parameters
    ----------
    settings : Settings
    encoder : Encoder
    store : SqlStore
    decoder : Decoder
    scheduler : Scheduler
        Owns the encoder.
    describers : Describers
    catalogue : Catalogue
        Of the maps' indexes.
    comparer : MapComparer
        Compares views in the background.
    loop : Loop or None
        None when only other processes describe images.
    settlements : Settlements
        Waits for a view to be described.
    attendance : Attendance
        Knows which workers are alive.
    bell : Bell
        Wakes the loop, and those of other processes.
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

    settings: Settings
    encoder: Encoder
    store: SqlStore
    decoder: Decoder
    scheduler: Scheduler
    describers: Describers
    catalogue: Catalogue
    comparer: MapComparer
    loop: Loop | None
    settlements: Settlements
    attendance: Attendance
    bell: Bell
    services: Services
    default_recipe: MapRecipe
    calibration: Callable[[MapRecipe], Calibration]
    schema_version: str
    serving: bool
    unlock: Callable[[], None]

    def start(self) -> None:
        """Clean up after a crash, then start the scheduler and the loop."""
        alone = self.serving and self.store.recover()  # a worker would delete the calls that the service is answering
        self.decoder.start()
        self.attendance.start(alone=alone)
        self.scheduler.start()
        if self.loop is not None:
            self.loop.start()
        self.bell.start(waits=self.serving)

    def decode(self, data: bytes) -> Image:
        """Bytes to Image; raises BadImage."""
        return self.decoder.decode(data)

    def stop(self) -> None:
        """Finish running work, put waiting jobs back, and release the data folder."""
        self.scheduler.stop_waiting()
        if self.loop is not None:
            self.loop.stop()
        self.attendance.stop()
        self.bell.stop()
        self.scheduler.stop()
        self.decoder.close()
        self.services.query.scores.stop()
        self.catalogue.close()
        self.store.close()
        self.unlock()


MakeEncoder = Callable[[Settings, int], tuple[Encoder, Segmenter | None]]
"""From settings and a number of threads to an encoder and its segmenter, if any."""


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
    threads = settings.threads or os.cpu_count() or 1
    configure(threads)
    settings.data.mkdir(parents=True, exist_ok=True)
    unlock = lock_for_serving(settings.data, datetime.now(UTC)).release if serving else _nothing
    try:
        encoder, segmenter = make_encoder(settings, threads)
        reserve = int(settings.reserve_mb * MEGA)
        store = open_store(settings.database_url, settings.data, reserve, settings.images, settings.index)
        store.refuse_foreign()
        batch = batch_of(settings)
        scheduler = make_scheduler(encoder, batch, settings.queries, segmenter)
        product = make_product(settings)
        general = [general_vocabulary(encoder, name) for name in PRESETS]
        describers = Describers(encoder, store.vocabularies, general, product)
        catalogue, selecting = make_catalogue(store, settings.index)
        decoder = make_decoder(settings)
        trainer = VocabularyTrainer(
            maps=store.maps, views=store.views, jobs=store.jobs, describers=describers, scheduler=scheduler,
            decode=decoder.decode_patiently,
        )  # fmt: skip
        settlements = Settlements(store.views, lambda: scheduler.away is not None)
        bell = Bell(store.notices, settlements.notify)
        snapshots = SnapshotService(
            files=store.snapshots, restorer=store.restoring, jobs=store.jobs, wake=bell.ring_all
        )
        comparer = MapComparer(
            comparisons=store.comparisons, descriptions=store.descriptions, catalogue=catalogue, product=product
        )
        shadows = ShadowService(
            maps=store.maps, views=store.views, listings=store.listings, descriptions=store.descriptions,
            comparisons=store.comparisons, kept=store.kept_queries, jobs=store.jobs, catalogue=catalogue,
            make_index=FlatIndex.of, comparer=comparer, describers=describers, scheduler=scheduler,
            decode=decoder.decode_patiently, calibration=calibration_of, shipped=shipped_calibration, product=product,
        )  # fmt: skip
        blurring = Blurring(encoder, scheduler, codec.Limits.of(settings).max_bytes)
        decoded = DecodedImages() if settings.inline_worker or not serving else DecodedImages(0)
        enrolment = BlurringEnrolment(store.enrolment, store.maps, blurring.cover, decoded)
        me = this_process("serve" if serving else "worker")
        duplicates = NearDuplicates(store.views, store.descriptions, catalogue)
        loop: Loop | None = None
        if settings.inline_worker or not serving:
            importer = Importer(
                uploads=store.uploads, jobs=store.jobs, removals=store.removals, enrolment=enrolment,
                settlements=settlements, decode=decoder.decode_patiently, read_exif=decoder.read_exif,
                look_for_problem=quality.problem_of, limits=Limits.of(settings), wake=bell.ring,
            )  # fmt: skip
            loop = Loop(
                jobs=store.jobs, views=store.views, pruning=store.pruning, scheduler=scheduler, describers=describers,
                map_jobs={
                    "vocabulary": trainer.run, "snapshot": snapshots.run, "import": importer.run, "shadow": shadows.run,
                },
                compare=idle_work(store.leftovers, store.indexing, comparer if settings.compare else None),
                decode=decoder.decode_patiently, decoded=decoded, name=me.name, batch=batch,
                trouble=StoringTrouble("descriptions", 2.0, settlements.refuse),
                refused=QualityGate(duplicates).problem_of,
            )  # fmt: skip
        attendance = Attendance.of(store, me, loop, settings.lease_s)
        if loop is not None:
            bell.hang(loop)
        default_recipe = make_recipe(encoder, Wanted(), preset=settings.preset)
        return Runtime(
            settings=settings, encoder=encoder, store=store, decoder=decoder, scheduler=scheduler,
            describers=describers, catalogue=catalogue, comparer=comparer, loop=loop, settlements=settlements,
            attendance=attendance, bell=bell,
            services=_services(
                settings=settings, encoder=encoder, store=store, scheduler=scheduler, describers=describers,
                catalogue=catalogue, selecting=selecting, decoder=decoder, product=product, settlements=settlements,
                default_recipe=default_recipe, bell=bell, attendance=attendance, snapshots=snapshots, shadows=shadows,
                blurring=blurring, enrolment=enrolment, duplicates=duplicates,
            ),
            default_recipe=default_recipe,
            calibration=shipped_calibration,
            schema_version=newest(),
            serving=serving,
            unlock=unlock,
        )  # fmt: skip
    except BaseException:
        unlock()
        raise


def _services(
    *,
    settings: Settings,
    encoder: Encoder,
    store: SqlStore,
    scheduler: Scheduler,
    describers: Describers,
    catalogue: Catalogue,
    selecting: Selecting,
    decoder: Decoder,
    product: Product,
    settlements: Settlements,
    default_recipe: MapRecipe,
    bell: Bell,
    attendance: Attendance,
    snapshots: SnapshotService,
    shadows: ShadowService,
    blurring: Blurring,
    enrolment: BlurringEnrolment,
    duplicates: NearDuplicates,
) -> Services:
    """The use-cases, each with its parts of the store."""
    explanations = Explanations(settings.explanations)
    searcher = Searcher(
        maps=store.maps,
        views=store.views,
        listings=selecting,
        descriptions=store.descriptions,
        comparisons=store.comparisons,
        queue=store.jobs,
        describers=describers,
        scheduler=scheduler,
        catalogue=catalogue,
        calibration=calibration_of,
        product=product,
    )
    enroll = EnrollService(
        maps=store.maps, enrolment=enrolment, views=store.views, removals=store.removals, queue=store.jobs,
        settlements=settlements, decode=decoder.decode, read_exif=decoder.read_exif,
        look_for_problem=quality.problem_of, default_recipe=default_recipe, limit=settings.queue,
        pace_s=lambda: scheduler.pace_s, wake=bell.ring, workers=lambda: attendance.alive, describer=searcher.describer,
        resembles=Resemblances(store.maps, store.descriptions, searcher, duplicates).of,
    )  # fmt: skip
    renderings = RenderingService(
        maps=store.maps, views=store.views, descriptions=store.descriptions, describers=describers,
        scheduler=scheduler, decode=decoder.decode, thumbnail=decoder.thumbnail, explanations=explanations,
    )  # fmt: skip
    changes = ChangeService(
        maps=store.maps, views=store.views, describers=describers, scheduler=scheduler, decode=decoder.decode,
        explanations=explanations,
    )  # fmt: skip
    scores = ScoreKeeper(store.day_scores)
    proposals = ProposalService(maps=store.maps, views=store.views, kept=store.kept_queries, enroll=enroll)
    health = HealthService(
        maps=store.maps, comparisons=store.comparisons, descriptions=store.descriptions, calibration=calibration_of,
        ageing=AgeingPlaces(store.day_scores, store.views, proposals.of, scores.write),
    )  # fmt: skip
    calibration = CalibrationService(
        maps=store.maps, views=store.views, listings=store.listings, descriptions=store.descriptions,
        comparisons=store.comparisons, catalogue=catalogue, describers=describers, shipped=shipped_calibration,
        product=product,
    )  # fmt: skip
    imports = ImportService(
        uploads=store.uploads, jobs=store.jobs, limits=Limits.of(settings), default_recipe=default_recipe,
        refuses_poor=store.maps.refuses_poor, wake=bell.ring_all, describer=searcher.describer,
    )  # fmt: skip
    return Services(
        enroll=enroll,
        inbox=InboxService(maps=store.maps, kept=store.kept_queries, enroll=enroll),
        proposals=proposals,
        query=QueryService(
            searcher=searcher,
            views=store.views,
            descriptions=store.descriptions,
            decode=decoder.decode,
            shrink=codec.shrink,
            look_for_problem=quality.problem_of,
            is_blank=quality.is_blank,
            thumbnail=decoder.thumbnail,
            kept=QueryKeeper(store.kept_queries, store.maps, blurring, scheduler, describers, decoder.decode),
            scores=scores,
            explanations=explanations,
            drives=Drives(searcher.further),
        ),
        searcher=searcher,
        views=ViewService(maps=store.maps, views=store.views, removals=store.removals, listings=store.listings),
        renderings=renderings,
        changes=changes,
        maps=MapService(
            maps=store.maps,
            removals=store.removals,
            jobs=store.jobs,
            uploads=store.uploads,
            comparisons=store.comparisons,
            shipped=shipped_calibration,
            encoder=encoder,
            describers=describers,
            catalogue=catalogue,
            preset=settings.preset,
            blurring=blurring,
            wake=bell.ring_all,
        ),
        jobs=JobService(store.jobs, store.uploads),
        keys=KeyService(store.keys),
        health=health,
        snapshots=snapshots,
        shadows=shadows,
        imports=imports,
        calibration=calibration,
    )  # fmt: skip


def _nothing() -> None:
    """Does nothing: a worker has no serving lock to release."""
