"""The one desk where pictures are encoded: queries first, enrolments when nobody asks."""

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import count, groupby
from typing import Any, Generic, TypeVar

from schemas.description import PixelField
from schemas.errors import Busy, Unavailable
from schemas.image import Image
from worker.description.ports import Encoder, Segmenter

T = TypeVar("T")
Finish = Callable[..., T]
"""Of a picture and its field; and of what was made beside the network, where something was."""

QUERY, ENROLMENT, CLOSE = 0, 1, 2

log = logging.getLogger("revisit.scheduler")


@dataclass(frozen=True)
class Timed(Generic[T]):
    """What came of a picture, and how long it took.

    Parameters
    ----------
    value : T
        Result of the `finish` function.
    queue_ms, encode_ms, finish_ms : float
        Waiting, the network (shared among a batch), and `finish`, with what was left to do beside the network.
    """

    value: T
    queue_ms: float
    encode_ms: float
    finish_ms: float


@dataclass(order=True)
class _Request:
    urgency: int
    number: int
    image: Image = field(compare=False)
    finish: Finish[Any] = field(compare=False)
    future: "Future[Timed[Any]]" = field(compare=False)
    since: float = field(compare=False)
    segment: bool = field(compare=False, default=False)
    parallel: Callable[[Image], Any] | None = field(compare=False, default=None)
    made: "Future[Any] | None" = field(compare=False, default=None)


class Scheduler:
    """One thread that owns the encoder, and two for what can be done while it is busy.

    What does not need the field (local features) is made beside the network: that of queries in a thread of their
    own, so that it waits for no enrolment. What is enrolled is described while the next picture is encoded.

    A query waits for the batch under way and for other queries, never for queued enrolments. The thread that
    encodes it describes it too, so that it does not wait for the description of an enrolment either.

    Parameters
    ----------
    encoder : Encoder
    batch : int
        Pictures encoded together. On a CPU one at a time is as quick, and keeps queries from waiting.
    queries : int
        Queries that may wait; more are refused with Busy.
    """

    def __init__(self, encoder: Encoder, batch: int, queries: int, segmenter: Segmenter | None = None) -> None:
        self._encoder = encoder
        self._segmenter = segmenter
        self._batch = batch
        self._queries = queries
        self._queue: queue.PriorityQueue[_Request] = queue.PriorityQueue()
        self._numbers = count()
        self._lock = threading.Lock()
        self._asked = 0
        self._pace_s = 0.2  # seconds per picture, a moving average; the start is a guess that the first ones correct
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="revisit-scheduler", daemon=True)
        self._describing = ThreadPoolExecutor(max_workers=1, thread_name_prefix="revisit-describing")
        self._parallel_queries = ThreadPoolExecutor(max_workers=1, thread_name_prefix="revisit-parallel-queries")

    @property
    def pace_s(self) -> float:
        """Measured seconds per picture."""
        return self._pace_s

    @property
    def alive(self) -> bool:
        """Whether pictures are being served."""
        return self._thread.is_alive() and not self._closed

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Serve what was handed in, then stop."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            nothing: Any = None
            self._queue.put(_Request(CLOSE, next(self._numbers), nothing, nothing, Future(), 0))
        if self._thread.is_alive():
            self._thread.join()
        self._describing.shutdown()
        self._parallel_queries.shutdown()

    def submit(
        self,
        image: Image,
        finish: Finish[T],
        *,
        urgent: bool,
        segment: bool = False,
        parallel: Callable[[Image], Any] | None = None,
    ) -> "Future[Timed[T]]":
        """Have a picture encoded, and `finish` called with it and its field (in a thread of the desk).

        With `segment` the field is the segmenter's, which is for drawing. What `parallel` makes of the picture, while
        the network works on it, is the third argument of `finish`.

        Raises
        ------
        Busy
            Too many queries wait already; only for urgent ones.
        Unavailable
            The service is stopping.
        """
        future: Future[Timed[T]] = Future()
        with self._lock:
            if self._closed:
                raise Unavailable("the service is stopping", 5)
            if urgent:
                if self._asked >= self._queries:
                    raise Busy.queue(self._asked, self._pace_s, "queries")
                self._asked += 1
                future.add_done_callback(self._answered)
            urgency = QUERY if urgent else ENROLMENT
            self._queue.put(
                _Request(urgency, next(self._numbers), image, finish, future, time.perf_counter(), segment, parallel)
            )
        return future

    def _answered(self, _: "Future[Any]") -> None:
        with self._lock:
            self._asked -= 1

    def _run(self) -> None:
        while True:
            first = self._queue.get()
            if first.urgency == CLOSE:
                return
            batch = [first]
            while len(batch) < self._batch:
                try:
                    following = self._queue.get_nowait()
                except queue.Empty:
                    break
                if following.urgency != first.urgency:
                    self._queue.put(following)
                    break
                batch.append(following)
            self._serve([r for r in batch if r.future.set_running_or_notify_cancel()])

    def _serve(self, batch: list[_Request]) -> None:
        began = time.perf_counter()
        timed = 0
        for request in batch:
            if request.parallel is not None and request.made is None:
                thread = self._parallel_queries if request.urgency == QUERY else self._describing
                request.made = thread.submit(request.parallel, request.image)
        try:
            fields = self._fields(batch)
            for request in batch:
                encoding = time.perf_counter()
                pixel_field = next(fields)
                encoded = time.perf_counter()
                timed += 1
                waited_ms, encode_ms = (began - request.since) * 1000, (encoded - encoding) * 1000
                if request.urgency == QUERY:
                    _finish(request, pixel_field, waited_ms, encode_ms)
                else:
                    self._describing.submit(_finish, request, pixel_field, waited_ms, encode_ms)
        except Exception as error:
            left = batch[timed:]
            if len(left) > 1:  # one picture must not take others down with it
                for request in left:
                    self._serve([request])
                return
            log.exception("the encoder failed on a picture")
            for request in left:
                request.future.set_exception(error)
        if batch:
            self._pace_s += 0.1 * ((time.perf_counter() - began) / len(batch) - self._pace_s)

    def _fields(self, batch: list[_Request]) -> Iterator[PixelField]:
        for segment, alike in groupby(batch, key=lambda request: request.segment):
            images = [request.image for request in alike]
            if segment and self._segmenter is not None:
                yield from map(self._segmenter.segment, images)
            else:
                yield from self._encoder.encode(images)


def _finish(request: _Request, pixel_field: PixelField, queue_ms: float, encode_ms: float) -> None:
    began = time.perf_counter()
    try:
        made = () if request.made is None else (request.made.result(),)
        value = request.finish(request.image, pixel_field, *made)
    except BaseException as error:  # belongs to the one who asked, not to the desk
        request.future.set_exception(error)
        return
    request.future.set_result(Timed(value, queue_ms, encode_ms, (time.perf_counter() - began) * 1000))
