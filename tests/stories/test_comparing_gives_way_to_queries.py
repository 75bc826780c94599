"""A robot queries the map that it has just enrolled: its answers do not wait for comparisons in the background."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from schemas.description import Description
from schemas.recipe import DescriptionRecipe
from schemas.records import ViewAttributes
from tests.sample_images import photo
from tests.stories.running import settings
from tests.waiting import PATIENCE_S
from worker.runtime import Runtime, build
from worker.service import comparing, giving_way
from worker.service.caller import Caller

VIEWS = 3


@pytest.fixture
def runtime(tmp_path: Path) -> Iterator[Runtime]:
    """A service with a map of `VIEWS` views that compares them when it is told to."""
    made = build(settings(tmp_path, compare=False))
    made.start()
    for number in range(VIEWS):
        made.services.enroll.enroll(photo(number), "town", ViewAttributes(), patience_s=PATIENCE_S)
    yield made
    made.stop()


def compared(runtime: Runtime) -> int:
    return runtime.store.comparisons.levels("town").compared


class Time:
    """A clock that goes on by rests alone; queries are under way until `quiet_at`."""

    def __init__(self, quiet_at: float) -> None:
        self.now, self.quiet_at = 0.0, quiet_at
        self.rests: list[float] = []

    def monotonic(self) -> float:
        return self.now

    def rest(self, seconds: float) -> bool:
        self.rests.append(seconds)
        self.now += seconds
        return False

    def quiet_s(self) -> float:
        return max(0.0, self.now - self.quiet_at)


@pytest.fixture
def clock(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> Time:
    made = Time(quiet_at=1.0)
    monkeypatch.setattr(comparing, "time", made)
    monkeypatch.setattr(runtime.comparer, "_quiet_s", made.quiet_s)
    return made


def test_nothing_is_compared_while_a_query_is_answered(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparing, "GIVE_WAY_S", 10 * PATIENCE_S)
    begun, looked = threading.Event(), threading.Event()
    read: list[int] = []
    whole = runtime.store.descriptions.whole

    def noted(seq: int, recipe: DescriptionRecipe) -> Description | None:
        read.append(seq)
        return whole(seq, recipe)

    def rest(seconds: float) -> bool:
        (looked if begun.is_set() else begun).set()
        time.sleep(seconds)
        return False

    monkeypatch.setattr(runtime.store.descriptions, "whole", noted)
    with ThreadPoolExecutor(1) as thread:
        with runtime.query_room.decoded(photo(9), Caller()):
            portion = thread.submit(runtime.comparer.step, rest=rest)
            assert looked.wait(PATIENCE_S)
            assert read == []
        assert portion.result(PATIENCE_S)
    assert compared(runtime) == len(read) == VIEWS


def test_comparing_goes_on_once_it_is_quiet(runtime: Runtime, clock: Time) -> None:
    """Not between two queries of a caller that queries again and again."""
    assert runtime.comparer.step(rest=clock.rest)
    assert clock.now == pytest.approx(clock.quiet_at + giving_way.QUIET_S, abs=giving_way.LOOK_S)
    assert compared(runtime) == VIEWS


def test_comparing_gets_on_beside_queries_without_end(runtime: Runtime, clock: Time) -> None:
    """Each view waits for `GIVE_WAY_S`. That was its rest too."""
    clock.quiet_at = float("inf")
    assert runtime.comparer.step(rest=clock.rest)
    assert clock.now == pytest.approx(VIEWS * comparing.GIVE_WAY_S, abs=VIEWS * giving_way.LOOK_S)
    assert clock.rests[-1] == 0
    assert compared(runtime) == VIEWS


def test_a_job_that_waits_does_not_wait_for_queries(runtime: Runtime, clock: Time) -> None:
    clock.quiet_at = float("inf")

    def woken(seconds: float) -> bool:
        clock.rests.append(seconds)
        assert len(clock.rests) < 100
        return True

    assert runtime.comparer.step(rest=woken)
    assert compared(runtime) == 1
