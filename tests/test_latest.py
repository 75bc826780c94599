"""What is remembered is bounded."""

import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import count

import pytest

from schemas.latest import Latest


@pytest.fixture
def in_turns() -> Iterator[None]:
    """Threads that take turns all the time."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def test_what_was_set_longest_ago_goes_first() -> None:
    kept = Latest[str, int](2)
    kept["gate"], kept["pond"], kept["gate"] = 1, 2, 3
    kept["hall"] = 4
    assert list(kept.items()) == [("gate", 3), ("hall", 4)]


def test_a_value_is_made_once_and_counts_as_set_whenever_it_is_read() -> None:
    kept = Latest[str, int](2)
    numbers = count()
    made = [kept.get_or_make(key, numbers.__next__) for key in ("gate", "pond", "gate", "hall")]
    assert made == [0, 1, 0, 2]
    assert list(kept.items()) == [("gate", 0), ("hall", 2)]


@pytest.mark.usefixtures("in_turns")
@pytest.mark.parametrize("most", [0, 1, 2])
def test_threads_set_values_at_once(most: int) -> None:
    """As queries do that are explained: of few that are kept, one may go before its thread has placed it."""
    kept = Latest[tuple[int, int], None](most)

    def set_many(thread: int) -> None:
        for number in range(20_000):
            kept[thread, number] = None

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(set_many, range(4)))
    assert len(kept) == most


def test_threads_that_want_the_same_value_have_it_made_once() -> None:
    """As queries at once do, of what takes a while and much memory to work out."""
    kept = Latest[str, int](2)
    begun, numbers = threading.Barrier(4), count()

    def make() -> int:
        time.sleep(0.05)
        return next(numbers)

    def want(_: int) -> int:
        begun.wait()
        return kept.get_or_make("gate", make)

    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(want, range(4))) == [0] * 4
    assert next(numbers) == 1


def test_what_fails_is_tried_again_and_keeps_no_other_value_waiting() -> None:
    kept = Latest[str, int](2)
    asks, answers = threading.Event(), threading.Event()

    def fail() -> int:
        asks.set()
        assert answers.wait(10)
        raise OSError("no pond")

    with ThreadPoolExecutor(2) as threads:
        failed = threads.submit(kept.get_or_make, "gate", fail)
        assert asks.wait(10)
        again = threads.submit(kept.get_or_make, "gate", lambda: 1)
        assert kept.get_or_make("pond", lambda: 2) == 2
        assert not again.done()
        answers.set()
        with pytest.raises(OSError, match="no pond"):
            failed.result(10)
        assert again.result(10) == 1
    assert dict(kept) == {"pond": 2, "gate": 1}
