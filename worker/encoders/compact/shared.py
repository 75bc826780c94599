"""The built-in encoder where its network runs elsewhere: fields come from a shared encoder, the rest is here."""

import logging
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import groupby
from pathlib import Path

import numpy as np

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import EncoderAway, SetupError
from schemas.image import Image, PreparedImage
from schemas.inference import model_name, segmenter_name
from worker.encoders.compact.encoder import WEIGHTS, CompactEncoder
from worker.encoders.compact.ensemble import CompactSegmenter, prepared
from worker.encoders.compact.input_size import network_size, resized
from worker.encoders.inference_client import InferenceClient, UnknownModel

log = logging.getLogger("revisit.encoder")

FROM_IMAGES = 4
"""Images of one size that go as several calls; fewer go as one."""


class SharedCompactEncoder(CompactEncoder):
    """`CompactEncoder` that sends what its network would get to a shared encoder, and gets the layers back.

    Labels and their text vectors stay in this process. Name and digest are those of the files here: the server is asked
    for just these weights, in every call. So it is with segmentations, which are for drawing and for blurring, unless
    the server has no segmenter (it is another program): then their networks are loaded here.

    Parameters
    ----------
    url : str
    key : str or None
    patience_s : float
        See `InferenceClient`.
    device, threads
        Of the segmentations where they are made here.
    weights : Path
        Those that the server has to have; see `CompactEncoder`.
    in_flight : int
        Calls that are under way at a time: while one is encoded, the other travels.

    Raises
    ------
    SetupError
        A file is missing or changed, or the server answers and has other weights or another key. One that does not
        answer is waited for.
    """

    def __init__(
        self,
        url: str,
        key: str | None,
        patience_s: float,
        device: str = "cpu",
        weights: Path = WEIGHTS,
        *,
        threads: int = 1,
        in_flight: int = 2,
    ) -> None:
        super().__init__(device, weights, threads=threads, encodes=False, segments=False)
        self._sending = ThreadPoolExecutor(in_flight, "revisit-sending")
        self._in_flight = in_flight
        self._client = InferenceClient(url, model_name(self.name, self.digest), self.layers, key, patience_s)
        self._here: CompactEncoder | None = None
        try:
            self._client.probe()
            if self.members and not self._client.has(segmenter_name(self.name, self.segmenter_digest)):
                log.warning(
                    "the encoder at %s makes no segmentations as this version does; they are made here",
                    url,
                    extra={"event": "segmentations_here"},
                )
                self._here = CompactEncoder(device, weights, threads=threads, encodes=False)
        except UnknownModel as error:
            self._client.close()
            raise SetupError(error.detail) from None
        except EncoderAway as error:
            log.warning("%s; images wait for it", error.detail, extra={"event": "encoder_away"})

    def close(self) -> None:
        """Close the connections."""
        self._sending.shutdown(cancel_futures=True)
        self._client.close()

    def segmenter(self) -> CompactSegmenter | None:
        """The segmentation ensemble of the server, or where it has none, of this process; None without its weights."""
        if self._here is not None:
            return self._here.segmenter()
        if not self.members:
            return None
        return SharedSegmenter(self._client, self.name, self.segmenter_digest, self.members)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """One field per image, in order; see `Encoder.encode`.

        Consecutive images of one size are sent together, many of them as two calls. A call that fails raises in the
        place of its first image, after the fields of those before it.
        """
        under_way: deque[tuple[list[Image], Future[Mapping[str, Floats]]]] = deque()
        calls = _calls(images, self._in_flight)
        if len(calls) == 1:  # a query, mostly: without another thread
            yield from _fields(calls[0], self._send(calls[0], urgent))
            return
        try:
            for alike in calls:
                under_way.append((alike, self._sending.submit(self._send, alike, urgent)))
                if len(under_way) == self._in_flight:
                    first, sent = under_way.popleft()
                    yield from _fields(first, sent.result())
            while under_way:
                first, sent = under_way.popleft()
                yield from _fields(first, sent.result())
        finally:
            for _, sent in under_way:
                sent.cancel()

    def _send(self, alike: list[Image], urgent: bool) -> Mapping[str, Floats]:
        return self._client.fields(np.stack([resized(image.pixels) for image in alike]), urgent=urgent)


def _calls(images: Sequence[Image], in_flight: int) -> list[list[Image]]:
    """Images by the calls that they go in, in order: each call has one size."""
    calls = []
    for _, run in groupby(images, key=lambda image: network_size(image.width, image.height)):
        alike = list(run)
        each = len(alike) if len(alike) < FROM_IMAGES else -(-len(alike) // in_flight)
        calls += [alike[start : start + each] for start in range(0, len(alike), each)]
    return calls


def _fields(images: list[Image], layers: Mapping[str, Floats]) -> Iterator[PixelField]:
    for number, image in enumerate(images):
        yield PixelField({name: layer[number] for name, layer in layers.items()}, image.extent)


class SharedSegmenter(CompactSegmenter):
    """Segmentations of a shared encoder: it gets the image at the scales of the ensemble, and what is drawn is the same
    to the byte.

    Parameters
    ----------
    client : InferenceClient
    name, digest : str
        Of the encoder, and of all that decides what is drawn.
    members : int
        Of the ensemble.
    """

    def __init__(self, client: InferenceClient, name: str, digest: str, members: int) -> None:
        self._client, self._model, self._members = client, segmenter_name(name, digest), members
        self.digest = digest

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        """See `Segmenter.segment`."""
        ready = image if isinstance(image, PreparedImage) else prepared(image, self._members)
        layer = self._client.segmentation(self._model, ready, urgent=urgent)
        return PixelField({SEMANTIC: layer}, image.extent)
