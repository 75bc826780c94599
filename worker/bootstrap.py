"""The one place that names adapters: settings in, a house out."""

import logging
import os
import platform
import sys
from datetime import UTC, datetime, timedelta
from functools import partial

import cv2
import faiss

from schemas.errors import SetupError
from schemas.ports import Encoder
from schemas.recipe import Recipe
from schemas.settings import Settings
from worker.description.describers import Describers
from worker.description.presets import PRESETS, general_vocabulary, make_recipe
from worker.description.scheduler import Scheduler
from worker.images import codec
from worker.loop import Loop
from worker.method.byte_vectors import Product, float_product
from worker.method.decision import shipped_calibration
from worker.runtime import Runtime
from worker.search.catalogue import Catalogue
from worker.search.flat_index import FlatIndex
from worker.search.searcher import Searcher
from worker.storage.locks import lock_for_serving
from worker.storage.migrating import newest
from worker.storage.store import open_store

log = logging.getLogger("revisit")

GPU_BATCH = 8

SWITCH_S = 0.001
"""After how long a thread lets another one into the interpreter: the encoder's comes back for a moment between calls of
many milliseconds, and by default may have to wait 5 ms for it (a tenth of an enrolment: docs/speed.md)."""


def build(settings: Settings, *, serving: bool = True) -> Runtime:
    """Build everything, start nothing.

    Parameters
    ----------
    settings : Settings
    serving : bool
        True for the one process that answers HTTP over a data folder; False for a worker beside it.

    Raises
    ------
    SetupError
        The data folder is in use, the database is newer than this program, or the encoder cannot be loaded.
    """
    threads = settings.threads or os.cpu_count() or 1
    cv2.setNumThreads(threads)
    faiss.omp_set_num_threads(1)
    sys.setswitchinterval(SWITCH_S)
    settings.data.mkdir(parents=True, exist_ok=True)
    unlock = lock_for_serving(settings.data, datetime.now(UTC)).release if serving else _nothing
    try:
        encoder = make_encoder(settings, threads)
        store = open_store(settings.database_url, settings.data)
        batch = settings.batch or (1 if settings.device == "cpu" else GPU_BATCH)
        scheduler = Scheduler(encoder, batch, settings.queries)
        general = {name: general_vocabulary(encoder, name) for name in PRESETS}
        product = make_product(settings)
        describers = Describers(encoder, store, general.values(), product)
        catalogue = Catalogue(store, _empty_index)
        limits = codec.Limits.of(settings)
        decode = partial(codec.decode, limits=limits)
        works = settings.inline_worker or not serving
        loop = Loop(
            store,
            scheduler,
            describers,
            decode,
            name=f"{platform.node()}:{os.getpid()}",
            batch=batch,
            lease=timedelta(seconds=settings.lease_s),
        )
        return Runtime(
            settings=settings,
            encoder=encoder,
            store=store,
            decode=decode,
            thumbnail=codec.thumbnail,
            shrink=codec.shrink,
            scheduler=scheduler,
            describers=describers,
            catalogue=catalogue,
            searcher=Searcher(store, catalogue, product),
            loop=loop if works else None,
            default_recipe=make_recipe(encoder, settings.preset),
            calibration=lambda recipe: shipped_calibration(recipe.encoder, recipe.preset),
            schema_version=newest(),
            serving=serving,
            unlock=unlock,
        )
    except BaseException:
        unlock()
        raise


def make_product(settings: Settings) -> Product:
    """How vectors of bytes are multiplied: with what is loaded for the encoder anyway."""
    if settings.encoder == "color":
        return float_product
    from worker.search.byte_product import fastest_product

    if settings.encoder == "compact" and settings.device == "cpu":
        import torch

        torch.set_num_threads(1)  # nothing but these products runs in torch then: more threads would only spin
    return fastest_product()


def make_encoder(settings: Settings, threads: int) -> Encoder:
    """The encoder that the settings name; networks are imported only when one is."""
    if settings.encoder == "color":
        from worker.encoders.color import ColorEncoder

        return ColorEncoder()
    if settings.encoder == "lseg" or settings.device != "cpu":
        _ready_torch(settings.device, threads)
    if settings.encoder == "compact":
        from worker.encoders.compact.encoder import CompactEncoder

        return CompactEncoder(settings.device, threads=threads)
    from worker.encoders.lseg.encoder import LsegEncoder

    return LsegEncoder.open(
        settings.weights,
        vocabulary=settings.bpe,
        mode=settings.lseg_mode,
        device=settings.device,
        batch=settings.batch,
    )


def _ready_torch(device: str, threads: int) -> None:
    import torch

    from worker.configure import keep_freed_memory

    keep_freed_memory()
    torch.set_num_threads(threads)
    if device != "cpu" and not torch.cuda.is_available():
        raise SetupError(f"REVISIT_DEVICE={device}, but this torch sees no GPU; set it to cpu")


def _empty_index(recipe: Recipe) -> FlatIndex:
    return FlatIndex({name: channel.length for name, channel in recipe.parameters.channels.items()}, recipe.id)


def _nothing() -> None:
    """A worker holds no lock of its own: the store it opens keeps migrations away."""
