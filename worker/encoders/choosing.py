"""The encoder that the settings name."""

from typing import TYPE_CHECKING

from schemas.errors import SetupError
from schemas.settings import Settings
from worker.configure import configure_torch, keep_freed_memory

if TYPE_CHECKING:
    from worker.description.ports import Encoder, Segmenter
    from worker.encoders.compact.encoder import CompactEncoder
    from worker.encoders.compact.ensemble import CompactSegmenter


SHAREABLE = ("compact", "compact-open")
"""Encoders that are the compact network, with weights of that name; nodes may share one."""

TOGETHER = 8
"""Images encoded together on a GPU, or sent together to a shared encoder, unless the settings say otherwise."""


def batch_of(settings: Settings) -> int:
    """How many images are encoded together; in this process's CPU one by one, which is as fast."""
    return settings.batch or (1 if settings.device == "cpu" and settings.encoder_url is None else TOGETHER)


def patience_of(settings: Settings) -> float:
    """Seconds for each part of a call of a shared encoder: together less than `wait`, which callers are promised; for a
    segmentation, which may take `SEGMENTED_WITHIN` of them to begin, no more than that."""
    return min(10.0, max(1.0, settings.wait / 4))


def make_encoder(settings: Settings, threads: int) -> "tuple[Encoder, Segmenter | None]":
    """The encoder that the settings name, and its segmenter, if any; only its own libraries are imported.

    Raises
    ------
    SetupError
        Its files or libraries do not do, or a shared encoder has other weights.
    """
    if settings.encoder_url is not None and settings.encoder not in SHAREABLE:
        raise SetupError(
            f"REVISIT_ENCODER={settings.encoder}, but a shared encoder (REVISIT_ENCODER_URL) has "
            f"{' or '.join(SHAREABLE)} alone; leave one of the two out"
        )
    if settings.encoder == "color":
        from worker.encoders.color import ColorEncoder

        return ColorEncoder(), None
    if settings.encoder == "lseg" or settings.device != "cpu":
        keep_freed_memory()
        configure_torch(threads, settings.device)
    if settings.encoder_url is not None:
        from worker.encoders.compact.encoder import weights_named
        from worker.encoders.compact.shared import SharedCompactEncoder

        key = None if settings.encoder_key is None else settings.encoder_key.get_secret_value()
        weights = weights_named(settings.encoder)
        shared = SharedCompactEncoder(
            settings.encoder_url, key, patience_of(settings), settings.device, weights, threads=threads
        )
        return shared, shared.segmenter()
    if settings.encoder in SHAREABLE:
        from worker.encoders.compact.encoder import CompactEncoder, weights_named

        compact = CompactEncoder(settings.device, weights_named(settings.encoder), threads=threads)
        return compact, compact.segmenter()
    from worker.encoders.lseg.encoder import LsegEncoder

    lseg = LsegEncoder.open(
        settings.weights,
        vocabulary=settings.bpe,
        mode=settings.lseg_mode,
        device=settings.device,
        batch=settings.batch,
    )
    return lseg, None


def make_encoder_to_share(settings: Settings, threads: int) -> "tuple[CompactEncoder, CompactSegmenter | None]":
    """An encoder and its segmenter, if any, for images that nodes prepared; raises SetupError as `make_encoder`."""
    if settings.encoder_url is not None:
        raise SetupError("REVISIT_ENCODER_URL is set: this process is such an encoder itself; leave it out here")
    if settings.encoder not in SHAREABLE:
        raise SetupError(f"REVISIT_ENCODER={settings.encoder}, but nodes share {' or '.join(SHAREABLE)} alone")
    if settings.device != "cpu":
        keep_freed_memory()
        configure_torch(threads, settings.device)
    from worker.encoders.compact.encoder import CompactEncoder, weights_named

    compact = CompactEncoder(settings.device, weights_named(settings.encoder), threads=threads, prepared=True)
    return compact, compact.segmenter()
