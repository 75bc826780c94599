"""The built-in encoder where its network runs elsewhere: fields come from a shared encoder, the rest is here."""

import logging
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from schemas.description import PixelField
from schemas.errors import EncoderAway, SetupError
from schemas.image import Image
from schemas.inference import model_name
from worker.encoders.compact.encoder import CompactEncoder
from worker.encoders.compact.input_size import network_size, resized
from worker.encoders.inference_client import InferenceClient, UnknownModel

log = logging.getLogger("revisit.encoder")


class SharedCompactEncoder(CompactEncoder):
    """`CompactEncoder` that sends what its network would get to a shared encoder, and gets the layers back.

    Labels, their text vectors and segmentations, which are for drawing and for blurring, stay in this process. Name and
    digest are those of the files here: the server is asked for just these weights, in every call.

    Parameters
    ----------
    url : str
    key : str or None
    patience_s : float
        See `InferenceClient`.
    device, threads
        Of the segmentations.

    Raises
    ------
    SetupError
        A file is missing or changed, or the server answers and has other weights or another key. One that does not
        answer is waited for.
    """

    def __init__(self, url: str, key: str | None, patience_s: float, device: str = "cpu", *, threads: int = 1) -> None:
        super().__init__(device, threads=threads, encodes=False)
        self._client = InferenceClient(url, model_name(self.name, self.digest), key, patience_s)
        try:
            self._client.probe()
        except UnknownModel as error:
            self._client.close()
            raise SetupError(error.detail) from None
        except EncoderAway as error:
            log.warning("%s; images wait for it", error.detail, extra={"event": "encoder_away"})

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image; see `Encoder.encode`. Consecutive images of one size are sent together."""
        for _, run in groupby(images, key=lambda p: network_size(p.width, p.height)):
            alike = list(run)
            layers = self._client.fields(np.stack([resized(image.pixels) for image in alike]), urgent=urgent)
            for number, image in enumerate(alike):
                yield PixelField({name: layer[number] for name, layer in layers.items()}, image.extent)
