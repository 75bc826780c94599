"""The scheduler of a network: batches images, in the order of `worker.description.turns`."""

import contextvars
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Generic, TypeVar

from schemas.description import PixelField
from schemas.errors import Busy, EncoderAway, EncoderFails, Unavailable
from schemas.image import Image
from schemas.threads import Threads
from worker.description.blame import encoded
from worker.description.ports import Encodes, Segmenter
from worker.description.priority import step_aside
from worker.description.turns import CLOSE, ENROLMENT, QUERY, Turns, Waiting

T = TypeVar("T")
Finish = Callable[..., T]
"""Called with an image and its pixel field, and the result of `parallel` where that was given."""

log = logging.getLogger("revisit.scheduler")

HOPELESS_S = 60.0
"""Seconds of failures on every image after which the encoder of this process is given up."""

HANGS_S = 600.0
"""Seconds with the same images after which it is given up: on a starved machine one may take minutes."""


@dataclass(frozen=True)
class Role:
    """What a scheduler's network is to those who wait for it.

    Parameters
    ----------
    name : str
        Of the network.
    requests : str
        What callers send, as a refusal names it.
    while_away : str
        What becomes of requests while the network is away, as a line of the log says it.
    """

    name: str
    requests: str
    while_away: str


ENCODER = Role("encoder", "queries", "queries are refused and enrolments wait")
SEGMENTER = Role("segmenter", "segmentations", "segmentations are refused or wait")


@dataclass(frozen=True)
class Timed(Generic[T]):
    """A result with the times that it took.

    Parameters
    ----------
    value : T
        Returned by the `finish` function.
    queue_ms, encode_ms, finish_ms : float
        Milliseconds in the queue, in the encoder, and in `finish`, including the wait for `parallel`.
    """

    value: T
    queue_ms: float
    encode_ms: float
    finish_ms: float


@dataclass(eq=False)
class _Request(Waiting):
    image: Image
    finish: Finish[Any]
    future: "Future[Timed[Any]]"
    since: float
    waits: bool = True
    parallel: Callable[[Image], Any] | None = None
    made: "Future[Any] | None" = None
    context: contextvars.Context = field(default_factory=contextvars.copy_context)  # of its log lines

    @property
    def given_up(self) -> bool:
        return self.future.cancelled()


class Scheduler:
    """One thread runs the network, two more run `parallel` and `finish` functions while it is busy.

    Work that does not need the pixel field (local features) runs parallel to the encoder; that of queries has a thread
    of its own, so that it does not wait for enrolments. An enrolment is described while the next image is encoded, at a
    lower priority than all else.

    A query waits for the running batch and for earlier queries, unless their callers give up (see `Turns`); of queued
    enrolments one has its turn after each `IN_A_ROW` queries. Its `finish` runs in the encoder's thread, so that it
    does not wait for the description of an enrolment either. A request whose future is cancelled before its turn is
    not encoded, and counts no longer as one that waits.

    While a shared encoder is away, or the one of this process fails on every image, queries fail with EncoderAway;
    enrolments wait until it is back.

    Parameters
    ----------
    encoder : Encodes
    batch : int
        Images encoded together. On a CPU 1 is as fast, and queries wait less.
    queries : int
        Queries that may wait; more are refused with Busy.
    role : Role
    """

    def __init__(self, encoder: Encodes, batch: int, queries: int, role: Role = ENCODER) -> None:
        self._encoder, self._role = encoder, role
        self._batch = batch
        self._queries = queries
        self._queue: Turns[_Request] = Turns()
        self._numbers = count()
        self._lock = threading.Lock()
        self._pending_queries = 0
        self._pace_s = 0.2  # seconds per image, a moving average; an initial guess
        self._encoded = 0
        self._closed = False
        self._held: list[_Request] = []  # enrolments that met an encoder that is away
        self._rest_until = 0.0
        self._away: EncoderAway | None = None
        self._away_since = self._away_last = 0.0
        self._serving_since: float | None = None
        self._waits = True
        self._thread = threading.Thread(target=self._run, name=f"revisit-{role.name}", daemon=True)
        self._describing = Threads(1, "revisit-describing", step_aside)
        self._parallel_queries = Threads(1, "revisit-parallel-queries")

    @property
    def pace_s(self) -> float:
        """Measured seconds per image."""
        return self._pace_s

    @property
    def queries_waiting(self) -> int:
        """Queries that wait for the encoder or are in it."""
        return self._pending_queries

    @property
    def encoded(self) -> int:
        """Number of images encoded so far."""
        return self._encoded

    @property
    def alive(self) -> bool:
        """Whether the scheduler runs and accepts images."""
        return self._thread.is_alive() and not self._closed

    @property
    def away(self) -> EncoderAway | None:
        """Why the encoder could not be had the last time; None once it encodes."""
        return self._away

    @property
    def stuck(self) -> str | None:
        """Why nothing goes on, in words: the thread has ended, or has been at one image for too long; else None."""
        if not self.alive:
            return f"the {self._role.name}'s thread has ended"
        since = self._serving_since
        if since is not None and (lasted_s := time.monotonic() - since) >= HANGS_S:
            return f"the {self._role.name} has been at one image for {lasted_s:.0f} s"
        return None

    @property
    def beyond_help(self) -> str | None:
        """What only another process mends, in words; None while there is nothing of the kind."""
        lasted_s = self._away_last - self._away_since
        if self.alive and isinstance(self._away, EncoderFails) and lasted_s >= HOPELESS_S:
            return f"the {self._role.name} has failed on every image for {lasted_s:.0f} s"
        return self.stuck

    def start(self) -> None:
        """Start the network's thread."""
        self._thread.start()

    def stop_waiting(self) -> None:
        """From now on enrolments, too, fail with EncoderAway while the encoder is away: nobody has time to wait."""
        self._waits = False
        self._queue.wake()  # for those that are held back until it is tried again

    def stop(self) -> None:
        """Finish all submitted images, then stop."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._waits = False
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
        waits: bool = True,
        parallel: Callable[[Image], Any] | None = None,
    ) -> "Future[Timed[T]]":
        """Queue an image to be encoded; the result is what `finish` returns.

        Parameters
        ----------
        image : Image
        finish : function
            Called in a thread of the scheduler with the image, its pixel field and, if given, the result of `parallel`.
        urgent : bool
            True for queries, False for enrolments.
        waits : bool
            Whether an enrolment waits while a shared encoder is away, or fails with EncoderAway as queries do.
        parallel : function, optional
            Called with the image while the encoder works on it.

        Raises
        ------
        Busy
            Too many queries wait; only for urgent requests.
        Unavailable
            The service is stopping.
        """
        future: Future[Timed[T]] = Future()
        with self._lock:
            if self._closed:
                raise Unavailable("the service is stopping", 5)
            if urgent:
                if self._pending_queries >= self._queries:
                    raise Busy.queue(self._pending_queries, self._pace_s, self._role.requests)
                self._pending_queries += 1
                future.add_done_callback(self._answered)
            urgency = QUERY if urgent else ENROLMENT
            self._queue.put(
                _Request(urgency, next(self._numbers), image, finish, future, time.perf_counter(), waits, parallel)
            )
        return future

    def _answered(self, _: "Future[Any]") -> None:
        with self._lock:
            self._pending_queries -= 1

    def _run(self) -> None:
        while (first := self._next()).urgency != CLOSE:
            batch = [first]
            while len(batch) < self._batch and (following := self._queue.get_alike(first)) is not None:
                batch.append(following)
            self._serving_since = time.monotonic()
            self._serve([r for r in batch if r.future.running() or r.future.set_running_or_notify_cancel()])
            self._serving_since = None

    def _next(self) -> _Request:
        """The next request. While enrolments are held back for the encoder, others join them, and queries go on."""
        while True:
            rest_s = max(0.0, self._rest_until - time.monotonic()) if self._held else None
            request = self._queue.get(rest_s)
            if request is None:
                self._let_go()
                continue
            if request.urgency == CLOSE and self._held:
                self._let_go()  # they come before it
                self._queue.put(request)
            elif self._away is not None and self._held and self._may_wait(request):
                self._held.append(request)
            else:
                return request

    def _let_go(self) -> None:
        """Put enrolments that were held back into the queue again, at their old places."""
        held, self._held = self._held, []
        for request in held:
            self._queue.put(request)

    def _put_off(self, left: list[_Request], error: EncoderAway) -> None:
        """Fail requests whose callers wait, since the network is away, and hold the others back."""
        self._away_last = time.monotonic()
        if self._away is None:
            self._away_since = self._away_last
            log.error(
                "%s; %s",
                error.detail,
                self._role.while_away,
                extra={"event": f"{self._role.name}_away"},
                exc_info=error.__cause__,
            )
        self._away = error
        self._rest_until = time.monotonic() + error.retry_after_s
        for request in left:
            if self._may_wait(request):
                self._held.append(request)
            else:
                request.future.set_exception(type(error)(error.detail, error.retry_after_s))

    def _may_wait(self, request: _Request) -> bool:
        return self._waits and request.waits and request.urgency == ENROLMENT

    def _came_back(self) -> None:
        self._away = None
        self._let_go()
        log.warning("the %s is back", self._role.name, extra={"event": f"{self._role.name}_back"})

    def _serve(self, batch: list[_Request]) -> None:
        if not batch:
            return
        began = time.perf_counter()
        timed = 0
        try:
            for request in batch:
                if request.parallel is not None and request.made is None:
                    thread = self._parallel_queries if request.urgency == QUERY else self._describing
                    request.made = thread.submit(request.context.copy().run, request.parallel, request.image)
            urgent = batch[0].urgency == QUERY
            fields = encoded(self._encoder, [r.image for r in batch], urgent=urgent, name=self._role.name)
            for request in batch:
                encoding = time.perf_counter()
                pixel_field = next(fields)
                made = time.perf_counter()
                self._encoded += 1
                if self._away is not None:
                    self._came_back()
                waited_ms, encode_ms = (began - request.since) * 1000, (made - encoding) * 1000
                if request.urgency == QUERY:
                    _finish(request, pixel_field, waited_ms, encode_ms)
                else:
                    self._describing.submit(_finish, request, pixel_field, waited_ms, encode_ms)
                timed += 1
        except EncoderAway as error:
            self._put_off(batch[timed:], error)
            return
        except Exception as error:
            left = batch[timed:]
            if len(left) > 1:  # one by one: an image must not fail the others
                for request in left:
                    self._serve([request])
                return
            for request in left:
                request.context.run(log.exception, "the %s failed on an image", self._role.name)
                request.future.set_exception(error)
        self._pace_s += 0.1 * ((time.perf_counter() - began) / len(batch) - self._pace_s)


def _finish(request: _Request, pixel_field: PixelField, queue_ms: float, encode_ms: float) -> None:
    began = time.perf_counter()
    try:
        made = () if request.made is None else (request.made.result(),)
        value = request.context.run(request.finish, request.image, pixel_field, *made)
    except BaseException as error:  # is the result of this request, not an error of the scheduler
        request.future.set_exception(error)
        return
    request.future.set_result(Timed(value, queue_ms, encode_ms, (time.perf_counter() - began) * 1000))


def field_alone(image: Image, field: PixelField) -> PixelField:
    """The `finish` function of a request for the pixel field itself."""
    return field


class _Segmentations:
    """What a scheduler runs to have images segmented."""

    def __init__(self, segmenter: Segmenter) -> None:
        self._segmenter = segmenter

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        """See `Encodes.encode`."""
        return (self._segmenter.segment(image, urgent=urgent) for image in images)


def segmenting(segmenter: Segmenter, most: int) -> Scheduler:
    """A scheduler of segmentations, which take as long as a dozen descriptions each: no query waits for one.

    Parameters
    ----------
    segmenter : Segmenter
    most : int
        Drawings that may wait; more are refused with Busy.
    """
    return Scheduler(_Segmentations(segmenter), 1, most, SEGMENTER)
