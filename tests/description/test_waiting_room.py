"""Queries decode their images while there is room for the pixels; the others hold none."""

import math
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from schemas.errors import Busy, CallerGone
from schemas.image import Image
from tests.waiting import PATIENCE_S, until
from worker.service.caller import Caller
from worker.service.waiting_room import WaitingRoom

SMALL = Image.of(np.zeros((10, 10, 3), np.uint8))  # of 300 bytes


_decoding = threading.local()


def decode(data: bytes) -> Image:
    """Of no bytes an image, once the query of this thread says so."""
    if data:
        raise ValueError("broken")
    _decoding.query.decoding()
    return SMALL


def room_for(limit: int, decoders: int, pace_s: float = 1.0, *, most_bytes: int = 10_000) -> WaitingRoom:
    return WaitingRoom(decode, "queries", limit=limit, decoders=decoders, pace_s=lambda: pace_s, most_bytes=most_bytes)


class Query:
    """A query in a thread of its own: decodes and leaves when it is told to."""

    def __init__(self, room: WaitingRoom, threads: ThreadPoolExecutor) -> None:
        self.caller = Caller()
        self.let_in, self.decoded = threading.Event(), threading.Event()
        self._decodes, self._leaves = threading.Event(), threading.Event()
        self.ended = threads.submit(self._run, room)

    def _run(self, room: WaitingRoom) -> None:
        _decoding.query = self
        with room.decoded(b"", self.caller) as decoded:
            assert decoded.image is SMALL
            self.decoded.set()
            assert self._leaves.wait(PATIENCE_S)

    def decoding(self) -> None:
        self.let_in.set()
        assert self._decodes.wait(PATIENCE_S)

    def decode(self) -> None:
        self._decodes.set()
        assert self.decoded.wait(PATIENCE_S)

    def leave(self) -> None:
        self.decode()
        self._leaves.set()
        self.ended.result(PATIENCE_S)


@pytest.fixture
def threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(20)


def entered(room: WaitingRoom, threads: ThreadPoolExecutor, count: int) -> list[Query]:
    """Queries, each of which waits before the next one comes."""
    queries: list[Query] = []
    for _ in range(count):
        before = room.outside
        queries.append(Query(room, threads))
        until(lambda: queries[-1].let_in.is_set() or room.outside == before + 1)  # noqa: B023
    return queries


def test_as_many_images_are_decoded_at_once_as_there_are_decoders(threads: ThreadPoolExecutor) -> None:
    room = room_for(10, 2)
    first, second, third = entered(room, threads, 3)
    assert (first.let_in.is_set(), second.let_in.is_set(), third.let_in.is_set()) == (True, True, False)
    second.decode()
    assert third.let_in.wait(PATIENCE_S)  # its pixels have room beside those of the second
    for query in (first, second, third):
        query.leave()
    assert room.outside == 0


def test_nobody_is_let_in_while_the_pixels_of_others_fill_the_room(threads: ThreadPoolExecutor) -> None:
    room = room_for(10, 5, most_bytes=600)
    first, second = entered(room, threads, 2)
    first.decode()
    second.decode()
    (third,) = entered(room, threads, 1)
    assert (third.let_in.is_set(), room.outside) == (False, 1)
    first.leave()
    assert third.let_in.wait(PATIENCE_S)
    second.leave()
    third.leave()


def test_an_image_that_cannot_be_decoded_leaves_its_place_to_the_next(threads: ThreadPoolExecutor) -> None:
    room = room_for(1, 1)
    with pytest.raises(ValueError, match="broken"), room.decoded(b"x", Caller()):
        pass
    (query,) = entered(room, threads, 1)
    query.leave()


def test_more_than_may_wait_are_refused_and_told_when_to_come_back(threads: ThreadPoolExecutor) -> None:
    room = room_for(3, 1, 2.5)
    queries = entered(room, threads, 3)
    with pytest.raises(Busy, match="3 queries are waiting") as refused, room.decoded(b"x", Caller()):
        pass
    assert refused.value.retry_after_s == 8
    for query in queries:
        query.leave()
    with pytest.raises(ValueError, match="broken"), room.decoded(b"x", Caller()):
        pass


def test_whoever_leaves_while_they_wait_is_passed_over(threads: ThreadPoolExecutor) -> None:
    room = room_for(10, 1)
    first, second, third, fourth = entered(room, threads, 4)
    second.caller.leave()
    with pytest.raises(CallerGone):
        second.ended.result(PATIENCE_S)
    first.leave()
    assert fourth.let_in.wait(PATIENCE_S)  # the newest: the third may be about to be given up, too
    assert not third.let_in.is_set()
    fourth.leave()
    third.leave()
    assert not second.let_in.is_set()


def test_it_is_quiet_since_the_last_image_left(threads: ThreadPoolExecutor) -> None:
    room = room_for(10, 1)
    assert room.quiet_s == math.inf
    first, second = entered(room, threads, 2)
    assert room.quiet_s == 0
    first.leave()
    assert room.quiet_s == 0
    second.leave()
    at_first = room.quiet_s
    assert 0 <= at_first < PATIENCE_S
    until(lambda: room.quiet_s > at_first)
