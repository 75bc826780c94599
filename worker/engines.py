"""What computes, as the settings name it: the encoder, the decoder of images, and the product of int8 vectors."""

from schemas.settings import Settings
from worker.configure import configure_torch, keep_freed_memory
from worker.description.ports import Encoder, Segmenter
from worker.images import codec
from worker.images.apart.pool import DecoderPool
from worker.images.decoder import Decoder, InProcessDecoder
from worker.method.byte_vectors import Product, float_product


def make_encoder(settings: Settings, threads: int) -> tuple[Encoder, Segmenter | None]:
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


def make_decoder(settings: Settings) -> Decoder:
    """Decoders in processes of their own, or in this one where the settings ask for none."""
    limits = codec.Limits.of(settings)
    return DecoderPool(settings.decoders, limits, settings.decode_s) if settings.decoders else InProcessDecoder(limits)


def make_product(settings: Settings) -> Product:
    """The product of int8 vectors: float32 for `color`, which loads no torch; otherwise the fastest."""
    if settings.encoder == "color":
        return float_product
    from worker.search.byte_product import fastest_product

    if settings.encoder == "compact" and settings.device == "cpu":
        configure_torch(1)  # nothing but these products runs in torch then: more threads would only spin
    return fastest_product()
