"""Where images wait before they are decoded, so that few of them hold pixels."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count

from schemas.errors import Busy
from schemas.image import Image
from worker.description.turns import QUERY, Turns, Waiting
from worker.service.caller import Caller


@dataclass(frozen=True, eq=False)
class Decoded:
    """An image whose turn came.

    Parameters
    ----------
    image : Image
    waited_ms, decode_ms : float
        Milliseconds until its turn came, and for decoding it.
    """

    image: Image
    waited_ms: float
    decode_ms: float


@dataclass(eq=False)
class _Seat(Waiting):
    let_in: "Future[None]" = field(default_factory=Future)
    byte_count: int | None = None  # of the pixels, once the image is decoded

    @property
    def given_up(self) -> bool:
        return self.let_in.cancelled()


class WaitingRoom:
    """Lets images be decoded while there is room for their pixels.

    A photo of 50 megapixels has 150 MB of them, and dozens of images may wait to be encoded or stored. Those that wait
    here hold only what was sent. `worker.description.turns` says whose turn it is: callers who gave up are passed over.

    How large an image is, is known once it is decoded. So the room is exceeded by no more than the images that are
    decoded at once.

    Parameters
    ----------
    decode : function
        Bytes to Image; raises BadImage.
    kind : str
        What waits here, such as ``queries``, for the error's text.
    limit : int
        Images that are inside or wait; more are refused with Busy.
    decoders : int
        Images that are decoded at once.
    pace_s : function
        Returns the measured seconds per image.
    most_bytes : int
        Of pixels inside, beyond which no other image is let in.
    """

    def __init__(
        self,
        decode: Callable[[bytes], Image],
        kind: str,
        *,
        limit: int,
        decoders: int,
        pace_s: Callable[[], float],
        most_bytes: int,
    ) -> None:
        self._decode, self._kind, self._limit, self._pace_s = decode, kind, limit, pace_s
        self._decoders, self._most_bytes = decoders, most_bytes
        self._numbers = count()
        self._turns: Turns[_Seat] = Turns()
        self._seats: list[_Seat] = []
        self._lock = threading.Lock()
        self._emptied = -math.inf  # when the last image left, of a monotonic clock

    @property
    def outside(self) -> int:
        """Images whose turn has not come."""
        with self._lock:
            return sum(not seat.let_in.done() for seat in self._seats)

    @property
    def quiet_s(self) -> float:
        """Seconds since the room was left empty; 0 while an image is inside or waits."""
        with self._lock:
            return 0.0 if self._seats else time.monotonic() - self._emptied

    @contextmanager
    def decoded(self, data: bytes, caller: Caller) -> Iterator[Decoded]:
        """An image, decoded when its turn comes; during the block it has its place in the room.

        Raises
        ------
        BadImage
        Busy
            Too many images wait.
        CallerGone
            The caller left before the turn came.
        """
        arrived = time.perf_counter()
        seat = self._arrive()
        try:
            caller.result(seat.let_in)
            entered = time.perf_counter()
            image = self._decode(data)
            self._hold(seat, image)
            yield Decoded(image, (entered - arrived) * 1000, (time.perf_counter() - entered) * 1000)
        finally:
            self._leave(seat)

    def _arrive(self) -> _Seat:
        with self._lock:
            if len(self._seats) >= self._limit:
                raise Busy.queue(len(self._seats), self._pace_s(), self._kind)
            seat = _Seat(QUERY, next(self._numbers))
            self._seats.append(seat)
            self._turns.put(seat)
            self._let_in()
        return seat

    def _hold(self, seat: _Seat, image: Image) -> None:
        with self._lock:
            seat.byte_count = image.pixels.nbytes
            self._let_in()

    def _leave(self, seat: _Seat) -> None:
        with self._lock:
            self._seats.remove(seat)
            self._emptied = time.monotonic()
            self._let_in()

    def _let_in(self) -> None:
        while self._has_room() and (seat := self._turns.get(0)) is not None:
            if seat.let_in.set_running_or_notify_cancel():
                seat.let_in.set_result(None)

    def _has_room(self) -> bool:
        inside = [seat.byte_count for seat in self._seats if seat.let_in.done() and not seat.given_up]
        held = [byte_count for byte_count in inside if byte_count is not None]
        return len(inside) - len(held) < self._decoders and sum(held) < self._most_bytes
