"""Work that goes on in a thread beside."""

import threading
from functools import partial

import pytest

from tests.waiting import until
from worker.storage.one_thread import OneThread


def test_work_is_done_in_the_order_in_which_it_was_given() -> None:
    done: list[int] = []
    thread = OneThread("test", most_bytes=30)
    for number in range(100):
        thread.do(10, partial(done.append, number))
    thread.finish()
    thread.close()
    assert done == list(range(100))


def test_no_more_waits_than_there_is_room_for() -> None:
    go_on = threading.Event()
    given: list[int] = []
    thread = OneThread("test", most_bytes=25)

    def give() -> None:
        for size in (10, 10, 10):
            thread.do(size, lambda: go_on.wait(60) and None)
            given.append(size)

    giving = threading.Thread(target=give)
    giving.start()
    until(lambda: given == [10, 10])
    giving.join(0.2)  # time enough to give more, if there were room
    assert given == [10, 10]
    go_on.set()
    giving.join()
    thread.do(1000, lambda: None)  # larger than the room, and taken alone
    thread.finish()
    thread.close()


def test_what_went_wrong_is_raised_later_and_the_rest_is_given_up() -> None:
    done: list[str] = []

    def fails() -> None:
        raise OSError("no space left")

    thread = OneThread("test", most_bytes=100)
    thread.do(1, fails)
    with pytest.raises(OSError, match="no space left"):
        thread.finish()
    thread.finish()  # told once
    block = threading.Event()
    thread.do(1, lambda: block.wait(60) and None)
    thread.do(1, lambda: done.append("never"))
    closing = threading.Thread(target=thread.close)
    closing.start()
    given_up = thread._given[-1][1]
    until(given_up.cancelled)
    block.set()
    closing.join()
    assert done == []
