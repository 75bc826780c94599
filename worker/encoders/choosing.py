"""The encoder that the settings name."""

from typing import TYPE_CHECKING

from schemas.settings import Settings
from worker.configure import configure_torch, keep_freed_memory

if TYPE_CHECKING:
    from worker.description.ports import Encoder, Segmenter


def make_encoder(settings: Settings, threads: int) -> "tuple[Encoder, Segmenter | None]":
    """The encoder that the settings name, and its segmenter, if any; only its own libraries are imported."""
    if settings.encoder == "color":
        from worker.encoders.color import ColorEncoder

        return ColorEncoder(), None
    if settings.encoder == "lseg" or settings.device != "cpu":
        keep_freed_memory()
        configure_torch(threads, settings.device)
    if settings.encoder == "compact":
        from worker.encoders.compact.encoder import CompactEncoder

        compact = CompactEncoder(settings.device, threads=threads)
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
