"""The use-case of a shared encoder: images of several nodes go through one network together."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from typing import Protocol

import numpy as np

from schemas.description import Floats, PixelField
from schemas.errors import BadBody, EncoderAway, NotFound, RevisitError
from schemas.image import Bytes2D, Image, PreparedImage
from schemas.inference import model_name, segmenter_name
from schemas.records import Meaning
from worker.description.ports import Encoder, Segmenter
from worker.description.scheduler import Scheduler, Timed, field_alone, segmenting
from worker.description.trial import tried

MOST_SEGMENTED = 8
"""Segmentations that may wait, urgent or not: each takes as long as a dozen images, and who wants one gives up soon."""

MOST_WAITING = 256
"""Images of queries that may wait, and as many of enrolments: half a megabyte each."""

NAMELESS = "0" * 64
"""Digest of images whose encoded bytes are not known here; the encoder does not read it."""


class SegmenterToShare(Segmenter, Protocol):
    """A segmenter of `PreparedImage`."""

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of all that decides what is drawn."""
        ...

    @property
    def scales(self) -> int:
        """Number of scales at which it sees an image."""
        ...


class EncodingService:
    """Encodes images for others: queries before enrolments, batches over all callers, a bounded queue.

    Nobody waits for a batch to fill: what has arrived while the network was at work goes together.

    Parameters
    ----------
    encoder : Encoder
    batch : int
        Most images that go through the network together.
    observe : function
        Called with the number of images of each batch.
    most : int
        Images of queries that may wait, and as many of enrolments.
    segmenter : SegmenterToShare or None
        Makes segmentations for others; None where it has none.
    """

    def __init__(
        self,
        encoder: Encoder,
        batch: int,
        observe: Callable[[int], None],
        most: int = MOST_WAITING,
        segmenter: SegmenterToShare | None = None,
    ) -> None:
        self.encoder, self.segmenter = encoder, segmenter
        self.model = model_name(encoder.name, encoder.digest)
        self.segmenting_model = None if segmenter is None else segmenter_name(encoder.name, segmenter.digest)
        self._most = most
        self._lock = threading.Lock()
        self._waiting = {True: 0, False: 0}
        self._scheduler = Scheduler(_Observed(encoder, observe), batch, most)
        self._segmenting = None if segmenter is None else segmenting(segmenter, MOST_SEGMENTED)
        self._segmented = 0

    @property
    def waiting(self) -> int:
        """Images that wait or are in the network."""
        return sum(self._waiting.values()) + self._segmented

    @property
    def away(self) -> bool:
        """Whether the encoder failed on every image the last time."""
        return self._scheduler.away is not None

    @property
    def beyond_help(self) -> str | None:
        """What only another process mends, in words; None while there is nothing of the kind."""
        return self._scheduler.beyond_help or (self._segmenting.stuck if self._segmenting is not None else None)

    def start(self) -> None:
        """Start the encoder's threads."""
        self._scheduler.start()
        if self._segmenting is not None:
            self._segmenting.start()

    def stop(self) -> None:
        """Finish what was submitted, and stop."""
        self._scheduler.stop()
        if self._segmenting is not None:
            self._segmenting.stop()

    def submit(self, pixels: Bytes2D, *, urgent: bool) -> list["Future[Timed[PixelField]]"]:
        """Queue images of one size.

        Parameters
        ----------
        pixels : uint8 of shape (n, height, width, 3)
            As the network gets them.
        urgent : bool
            Whether they go before those that are not.

        Raises
        ------
        BadBody
            So many are never let in together.
        EncoderAway
            Too many wait.
        Unavailable
            The process is stopping.
        """
        if len(pixels) > self._most:
            raise BadBody("malformed-body", f"{len(pixels)} images at once; no more than {self._most} are let in")
        with self._lock:
            waiting = self._waiting[urgent]
            if waiting + len(pixels) > self._most:
                after_s = max(1, round(waiting * self._scheduler.pace_s))
                raise EncoderAway(
                    f"{waiting} images are waiting, and no more than {self._most} are let in; try again in {after_s} s",
                    after_s,
                )
            self._waiting[urgent] += len(pixels)
        futures: list[Future[Timed[PixelField]]] = []
        try:
            for one in pixels:
                futures.append(self._scheduler.submit(Image(one, NAMELESS), field_alone, urgent=urgent))  # noqa: PERF401
        finally:
            self._ended(urgent, len(pixels) - len(futures))
            for future in futures:
                future.add_done_callback(lambda _: self._ended(urgent, 1))
        return futures

    def submit_segmentation(
        self, scales: Sequence[Bytes2D], grid: tuple[int, int], *, urgent: bool
    ) -> "Future[Timed[PixelField]]":
        """Queue an image to be segmented; raises as `submit`, and NotFound without a segmenter.

        Parameters
        ----------
        scales : sequence of uint8 of shape (height, width, 3)
            The image at each scale, smallest first.
        grid : (int, int)
            Rows and columns of the segmentation.
        urgent : bool
        """
        if self._segmenting is None:
            raise NotFound("model", "segmenter", "this encoder has none")
        image = PreparedImage(scales[-1], NAMELESS, scales=tuple(scales), grid=grid)
        with self._lock:
            waiting = self._segmented
            if waiting >= MOST_SEGMENTED:
                after_s = max(1, round(waiting * self._segmenting.pace_s))
                raise EncoderAway(
                    f"{waiting} segmentations are waiting, and no more are let in; try again in {after_s} s", after_s
                )
            self._segmented += 1
        try:
            future = self._segmenting.submit(image, field_alone, urgent=urgent)
        except RevisitError:
            self._segmentation_ended()
            raise
        future.add_done_callback(lambda _: self._segmentation_ended())
        return future

    def _segmentation_ended(self) -> None:
        with self._lock:
            self._segmented -= 1

    def _ended(self, urgent: bool, count: int) -> None:
        with self._lock:
            self._waiting[urgent] -= count

    def check(self, patience_s: float) -> str:
        """``ok`` once an image was encoded, or why it was not."""
        return tried(self._scheduler, patience_s)


def stacked(fields: Sequence[PixelField]) -> Mapping[str, Floats]:
    """Layers of images of one size, float32 of shape (n, rows, columns, channels) each."""
    return {name: np.stack([field.layers[name] for field in fields]) for name in fields[0].layers}


class _Observed:
    """An encoder that tells how many images it is given at a time."""

    def __init__(self, encoder: Encoder, observe: Callable[[int], None]) -> None:
        self._encoder, self._observe = encoder, observe
        self.name, self.digest, self.terms = encoder.name, encoder.digest, encoder.terms
        self.layers, self.known_labels = encoder.layers, encoder.known_labels

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        self._observe(len(images))
        return self._encoder.encode(images, urgent=urgent)

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        return self._encoder.text_vectors(labels)

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        return self._encoder.meanings(labels)
