"""Bodies of requests take no more memory together than there is for them, and slow ones keep nobody out."""

import asyncio

import pytest

from app.http.body_room import PATIENCE_S, SMALL_BYTES, Body, BodyRoom
from schemas.errors import Busy


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def room(clock: Clock) -> BodyRoom:
    return BodyRoom(100, 1, clock)


def test_what_does_not_fit_is_refused_until_others_are_answered(room: BodyRoom) -> None:
    first, second = room.open(), room.open()
    room.add(first, 60)
    room.add(second, 40)
    with pytest.raises(Busy, match="try again in 2 s") as refused:
        room.add(second, 1)
    assert refused.value.retry_after_s == 2
    room.close(first)
    room.add(second, 60)
    room.close(second)
    room.add(room.open(), 100)


async def _waits(body: Body) -> bool:
    """Whether its bytes are waited for in vain, since it made room."""
    try:
        async with body.wait(60):
            await asyncio.sleep(60)
    except TimeoutError:
        return body.made_room
    return False


def test_the_body_that_has_been_arriving_for_longest_makes_room(room: BodyRoom, clock: Clock) -> None:
    async def run() -> None:
        bodies = []
        for _ in range(3):
            clock.now += 1
            bodies.append(room.open())
            room.add(bodies[-1], 30)
        waiting = [asyncio.create_task(_waits(body)) for body in bodies]
        await asyncio.sleep(0)
        newest = room.open()
        with pytest.raises(Busy):  # a photo takes its time
            room.add(newest, 20)
        clock.now = 2 + PATIENCE_S + 0.5
        room.add(newest, 60)
        assert await waiting[0]
        assert await waiting[1]
        room.close(bodies[0])  # what it held is given back once
        with pytest.raises(Busy):
            room.add(newest, 11)
        assert not waiting[2].done()
        waiting[2].cancel()

    asyncio.run(run())


def test_a_body_that_has_arrived_is_kept_however_long_its_answer_takes(room: BodyRoom, clock: Clock) -> None:
    whole = room.open()
    room.add(whole, 90)
    clock.now = 1000
    with pytest.raises(Busy):
        room.add(room.open(), 20)
    assert (whole.byte_count, whole.made_room) == (90, False)


def test_a_body_that_holds_nothing_is_not_given_up_for_others(room: BodyRoom, clock: Clock) -> None:
    """One that goes into a file, as of an import."""

    async def run() -> None:
        body = room.open()
        waiting = asyncio.create_task(_waits(body))
        await asyncio.sleep(0)
        clock.now = 1000
        with pytest.raises(Busy):
            room.add(room.open(), 101)
        assert not waiting.done()
        waiting.cancel()

    asyncio.run(run())


def test_the_last_quarter_is_for_small_bodies() -> None:
    """A robot's query is not kept out by large photos that others enrol."""
    room = BodyRoom(100 * SMALL_BYTES, 25 * SMALL_BYTES)
    for _ in range(3):
        room.add(room.open(), 25 * SMALL_BYTES)
    with pytest.raises(Busy):
        room.add(room.open(), 2 * SMALL_BYTES)
    room.add(room.open(), SMALL_BYTES)


def test_the_largest_body_has_room_however_little_that_is() -> None:
    room = BodyRoom(2 * SMALL_BYTES, 25 * SMALL_BYTES)
    body = room.open()
    for _ in range(25):
        room.add(body, SMALL_BYTES)
    with pytest.raises(Busy):
        room.add(room.open(), SMALL_BYTES)
