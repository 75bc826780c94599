"""Decoded images lie in memory that is used again, and never by two at once."""

import threading

import numpy as np
from hypothesis import given, settings, strategies as st

from worker.images.apart.buffers import SMALLEST, Buffers


def pixels(value: int, rows: int = 700) -> "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]":
    return np.full((rows, 500, 3), value, np.uint8)


def test_memory_is_used_again_once_nothing_refers_to_it() -> None:
    buffers = Buffers(2, 1 << 24)
    first = buffers.copy(pixels(1))
    where = first.ctypes.data
    cropped = first[10:20, 5:9]
    del first
    second = buffers.copy(pixels(2))
    assert (cropped == 1).all()
    assert second.ctypes.data != where
    del cropped
    assert buffers.copy(pixels(3)).ctypes.data == where
    assert (second == 2).all()


def test_what_is_small_or_large_has_memory_of_its_own() -> None:
    buffers = Buffers(2, SMALLEST)
    for rows in (10, 2000):
        one, other = buffers.copy(pixels(1, rows)), buffers.copy(pixels(2, rows))
        assert (one == 1).all()
        assert (other == 2).all()
        assert one.flags.owndata


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from([700, 900, 1300])), max_size=20))
def test_images_that_are_held_never_change(steps: list[tuple[int, int]]) -> None:
    buffers = Buffers(2, 1 << 24)
    held: dict[int, tuple[int, object]] = {}
    for value, (slot, rows) in enumerate(steps, start=1):
        held[slot] = value, buffers.copy(pixels(value, rows))
        for expected, image in held.values():
            assert (np.asarray(image) == expected).all()


def test_threads_get_memory_of_their_own() -> None:
    buffers, wrong = Buffers(3, 1 << 24), []

    def work(value: int) -> None:
        for _ in range(30):
            image = buffers.copy(pixels(value))
            if not (image == value).all():
                wrong.append(value)

    threads = [threading.Thread(target=work, args=(value,)) for value in range(1, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
