"""What jobs and use-cases share in a process: the encoder, the store, the decoder, and what works on them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from schemas.settings import MEGA, Settings
from worker.description.describers import Describers
from worker.description.ports import Encoder, Segmenter
from worker.description.presets import PRESETS, general_vocabulary
from worker.description.scheduler import Scheduler, segmenting
from worker.encoders.choosing import batch_of
from worker.images import codec
from worker.images.apart.pool import make_decoder
from worker.images.decoder import Decoder
from worker.method.byte_vectors import Product
from worker.search.byte_product import make_product
from worker.search.choosing import make_catalogue
from worker.search.flat_index import FlatIndex
from worker.search.ports import Catalogue, Selecting
from worker.service.bell import Bell
from worker.service.blurring import Blurring, BlurringEnrolment
from worker.service.calibrations import calibration_of, shipped_calibration
from worker.service.comparing import MapComparer
from worker.service.decoded import DecodedImages
from worker.service.duplicates import NearDuplicates
from worker.service.settlements import Settlements
from worker.service.shadows import ShadowService
from worker.service.snapshots import SnapshotService
from worker.service.waiting_room import WaitingRoom
from worker.storage.store import SqlStore, open_store

MakeEncoder = Callable[[Settings, int], tuple[Encoder, Segmenter | None]]
"""From settings and a number of threads to an encoder and its segmenter, if any."""


@dataclass(frozen=True)
class Parts:
    """One of each, built by `make_parts`.

    Parameters
    ----------
    settings : Settings
    encoder : Encoder
    store : SqlStore
    decoder : Decoder
    scheduler : Scheduler
        Owns the encoder.
    segmenting : Scheduler or None
        Owns the segmenter, if there is one.
    describers : Describers
    catalogue : Catalogue
        Of the maps' indexes.
    selecting : Selecting
        Turns filters into the selections that these indexes search.
    product : Product
        Multiplies int8 vectors, by the faster method on this processor.
    settlements : Settlements
        Waits for a view to be described.
    bell : Bell
        Wakes the loop, and those of other processes.
    snapshots : SnapshotService
    shadows : ShadowService
    comparer : MapComparer
        Compares views in the background.
    query_room, enrolment_room : WaitingRoom
        Where images wait before they are decoded.
    blurring : Blurring
    enrolment : BlurringEnrolment
        Stores images, blurred where their map says so.
    decoded : DecodedImages
        Images that this process decoded and will describe itself; it keeps none where it has no loop.
    duplicates : NearDuplicates
    """

    settings: Settings
    encoder: Encoder
    store: SqlStore
    decoder: Decoder
    scheduler: Scheduler
    segmenting: Scheduler | None
    describers: Describers
    catalogue: Catalogue
    selecting: Selecting
    product: Product
    settlements: Settlements
    bell: Bell
    snapshots: SnapshotService
    shadows: ShadowService
    comparer: MapComparer
    query_room: WaitingRoom
    enrolment_room: WaitingRoom
    blurring: Blurring
    enrolment: BlurringEnrolment
    decoded: DecodedImages
    duplicates: NearDuplicates


def make_parts(
    settings: Settings, threads: int, *, describes: bool, make_encoder: MakeEncoder, make_scheduler: type[Scheduler]
) -> Parts:
    """Build the parts, start none.

    Parameters
    ----------
    settings : Settings
    threads : int
        Of the encoder.
    describes : bool
        Whether this process has a loop that describes images.
    make_encoder, make_scheduler
        See `worker.runtime.build`.

    Raises
    ------
    SetupError
        The database is newer than this program, the images are of another database, or the encoder cannot be loaded.
    """
    encoder, segmenter = make_encoder(settings, threads)
    reserve = int(settings.reserve_mb * MEGA)
    store = open_store(settings.database_url, settings.data, reserve, settings.images, settings.index)
    store.refuse_foreign()
    scheduler = make_scheduler(encoder, batch_of(settings), settings.queries)
    segmentations = None if segmenter is None else segmenting(segmenter, settings.queries)
    product = make_product(settings)
    general = [general_vocabulary(encoder, name) for name in PRESETS]
    describers = Describers(encoder, store.vocabularies, general, product)
    catalogue, selecting = make_catalogue(store, settings.index)
    decoder = make_decoder(settings)
    settlements = Settlements(store.views, lambda: scheduler.away is not None)
    bell = Bell(store.notices, settlements.notify)
    room = partial(WaitingRoom, decoder.decode, decoders=max(1, settings.decoders), pace_s=lambda: scheduler.pace_s)
    query_room = room("queries", limit=settings.queries, most_bytes=settings.query_pixel_bytes)
    comparer = MapComparer(
        comparisons=store.comparisons, descriptions=store.descriptions, catalogue=catalogue, product=product,
        quiet_s=lambda: query_room.quiet_s,
    )  # fmt: skip
    shadows = ShadowService(
        maps=store.maps, views=store.views, listings=store.listings, descriptions=store.descriptions,
        comparisons=store.comparisons, kept=store.kept_queries, jobs=store.jobs, catalogue=catalogue,
        make_index=FlatIndex.of, comparer=comparer, describers=describers, scheduler=scheduler,
        decode=partial(decoder.decode, patient=True, stored=True), calibration=calibration_of,
        shipped=shipped_calibration, product=product,
    )  # fmt: skip
    blurring = Blurring(encoder, segmentations or scheduler, codec.Limits.of(settings).max_bytes)
    decoded = DecodedImages(settings.handed_on_pixel_bytes if describes else 0)
    return Parts(
        settings=settings,
        encoder=encoder,
        store=store,
        decoder=decoder,
        scheduler=scheduler,
        segmenting=segmentations,
        describers=describers,
        catalogue=catalogue,
        selecting=selecting,
        product=product,
        settlements=settlements,
        bell=bell,
        snapshots=SnapshotService(files=store.snapshots, restorer=store.restoring, jobs=store.jobs, wake=bell.ring_all),
        shadows=shadows,
        comparer=comparer,
        query_room=query_room,
        enrolment_room=room("enrolments", limit=settings.queue, most_bytes=settings.enrolment_pixel_bytes),
        blurring=blurring,
        enrolment=BlurringEnrolment(store.enrolment, store.maps, blurring.cover, decoded),
        decoded=decoded,
        duplicates=NearDuplicates(store.views, store.descriptions, catalogue),
    )
