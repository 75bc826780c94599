"""Queries come first, one failure is one image's, and stopping serves what was submitted."""

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any

import pytest

from schemas.description import PixelField
from schemas.errors import Busy, Unavailable
from schemas.image import Image
from schemas.log_context import bound, fields
from tests.description.gated import GatedEncoder, image, number_of
from tests.waiting import PATIENCE_S
from worker.description.priority import LOWER
from worker.description.scheduler import Scheduler, Timed
from worker.description.turns import IN_A_ROW


def test_a_query_overtakes_every_enrolment_that_is_not_yet_under_way() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2, 3)]
    encoder.entered.acquire()  # the first enrolment is being encoded
    query = scheduler.submit(image(7), number_of, urgent=True)
    encoder.gate.release(4)

    assert query.result(PATIENCE_S).value == 7
    assert [future.result(PATIENCE_S).value for future in enrolments] == [1, 2, 3]
    assert encoder.seen == [1, 7, 2, 3]
    scheduler.stop()


def test_an_enrolment_has_its_turn_among_queries_without_end() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=50)
    scheduler.start()
    queries = [scheduler.submit(image(50), number_of, urgent=True)]
    encoder.entered.acquire()  # the first query is being encoded
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2)]
    queries += [scheduler.submit(image(51 + n), number_of, urgent=True) for n in range(2 * IN_A_ROW + 3)]
    encoder.gate.release(99)

    assert [future.result(PATIENCE_S).value for future in enrolments] == [1, 2]
    assert [future.result(PATIENCE_S).value for future in queries] == list(range(50, 54 + 2 * IN_A_ROW))
    assert [encoder.seen.index(n) for n in (1, 2)] == [1 + IN_A_ROW, 2 + 2 * IN_A_ROW]
    scheduler.stop()


def test_a_query_is_answered_while_an_enrolment_is_still_being_described() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    answered = threading.Event()

    def slow(shown: Image, field: PixelField) -> int:
        assert answered.wait(PATIENCE_S)
        return number_of(shown, field)

    enrolments = [scheduler.submit(image(n), slow, urgent=False) for n in (1, 2)]
    assert scheduler.submit(image(7), number_of, urgent=True).result(PATIENCE_S).value == 7
    answered.set()
    assert [future.result(PATIENCE_S).value for future in enrolments] == [1, 2]
    scheduler.stop()


def test_what_needs_no_field_is_made_while_the_network_is_busy() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    made = threading.Event()

    def found(shown: Image) -> str:
        made.set()
        return f"picture {shown.pixels[0, 0, 0]}"

    query = scheduler.submit(
        image(7), lambda p, f, keypoints: (number_of(p, f), keypoints), urgent=True, parallel=found
    )
    assert made.wait(PATIENCE_S)  # and the encoder is still held back
    encoder.gate.release()
    assert query.result(PATIENCE_S).value == (7, "picture 7")
    scheduler.stop()


def test_a_query_waits_for_nothing_that_runs_in_parallel_for_an_enrolment() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    begun, answered = threading.Event(), threading.Event()

    def slow(_: Image) -> bool:
        begun.set()
        return answered.wait(PATIENCE_S)

    enrolment = scheduler.submit(image(1), lambda p, f, waited: waited, urgent=False, parallel=slow)
    assert begun.wait(PATIENCE_S)
    query = scheduler.submit(image(7), lambda p, f, keypoints: keypoints, urgent=True, parallel=lambda _: "keypoints")
    assert query.result(PATIENCE_S / 2).value == "keypoints"
    answered.set()
    assert enrolment.result(PATIENCE_S).value
    scheduler.stop()


def test_a_failure_in_parallel_to_the_encoder_belongs_to_its_request() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()

    def fail(_: Image) -> int:
        raise ValueError("no keypoints today")

    with pytest.raises(ValueError, match="no keypoints"):
        scheduler.submit(image(1), lambda p, f, keypoints: keypoints, urgent=True, parallel=fail).result(PATIENCE_S)
    assert scheduler.submit(image(2), number_of, urgent=True).result(PATIENCE_S).value == 2
    scheduler.stop()


def test_one_failing_image_does_not_take_its_batch_down() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=4, queries=5)
    futures = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 99, 3)]
    encoder.gate.release(9)
    scheduler.start()

    assert futures[0].result(PATIENCE_S).value == 1
    with pytest.raises(RuntimeError, match="kills"):
        futures[1].result(PATIENCE_S)
    assert futures[2].result(PATIENCE_S).value == 3
    scheduler.stop()


@pytest.mark.parametrize("parallel", [None, lambda _: ()], ids=["to finish it", "beside the encoder"])
def test_what_cannot_be_handed_on_fails_alone_and_the_encoders_thread_goes_on(
    parallel: Callable[[Image], object] | None,
) -> None:
    """As where the system has no memory for a moment: nobody waits for ever, and stopping ends."""
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    hand_on, short = scheduler._describing.submit, [MemoryError()]

    def submit(*given: Any) -> "Future[Any]":
        if short:
            raise short.pop()
        return hand_on(*given)

    scheduler._describing.submit = submit  # type: ignore[method-assign,assignment]
    scheduler.start()

    def finish(shown: Image, field: PixelField, *made: object) -> int:
        return number_of(shown, field)

    first = scheduler.submit(image(1), finish, urgent=False, parallel=parallel)
    with pytest.raises(MemoryError):
        first.result(PATIENCE_S)
    assert scheduler.submit(image(2), finish, urgent=False, parallel=parallel).result(PATIENCE_S).value == 2
    assert scheduler.alive
    scheduler.stop()


def test_more_queries_than_are_let_in_are_refused_with_a_time_to_come_back() -> None:
    scheduler = Scheduler(GatedEncoder(), batch=1, queries=2)
    for number in (1, 2):
        scheduler.submit(image(number), number_of, urgent=True)

    with pytest.raises(Busy, match="2 queries are waiting") as refusal:
        scheduler.submit(image(3), number_of, urgent=True)

    assert refusal.value.retry_after_s >= 1
    scheduler.submit(image(4), number_of, urgent=False)  # enrolments have a queue of their own


def test_queries_that_were_given_up_take_nobodys_turn_and_no_place_in_the_queue() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=2 * IN_A_ROW)
    scheduler.start()
    given_up = [scheduler.submit(image(50 + n), number_of, urgent=True) for n in range(2 * IN_A_ROW)]
    encoder.entered.acquire()  # the first query is being encoded
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2)]
    assert [future.cancel() for future in given_up] == [False] + [True] * (2 * IN_A_ROW - 1)
    assert scheduler.queries_waiting == 1

    query = scheduler.submit(image(7), number_of, urgent=True)
    encoder.gate.release(4)
    assert query.result(PATIENCE_S).value == 7
    assert [future.result(PATIENCE_S).value for future in enrolments] == [1, 2]
    assert encoder.seen == [50, 7, 1, 2]
    scheduler.stop()


def test_callers_less_patient_than_the_queue_is_long_are_answered_all_the_same() -> None:
    """Five ask where one is answered, and each gives up after six such steps."""
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=99)
    scheduler.start()
    held = scheduler.submit(image(98), number_of, urgent=True)
    encoder.entered.acquire()
    waiting: list[tuple[int, Future[Timed[int]]]] = []
    answered = 0
    for step in range(40):
        waiting += [(step, scheduler.submit(image(1), number_of, urgent=True)) for _ in range(5)]
        for since, future in waiting:
            if since <= step - 6:
                future.cancel()
        encoder.gate.release()
        encoder.entered.acquire()  # the next one is being encoded
        in_time = [since for since, future in waiting if future.done() and not future.cancelled()]
        answered += sum(since > step - 6 for since in in_time)
        waiting = [(since, future) for since, future in waiting if not future.done()]
    encoder.gate.release(99)
    scheduler.stop()
    assert held.done()
    assert answered >= 36


def test_stopping_serves_what_was_submitted_and_refuses_what_comes_after() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    futures = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2)]
    scheduler.start()
    scheduler.stop()

    assert [future.result(0).value for future in futures] == [1, 2]
    with pytest.raises(Unavailable):
        scheduler.submit(image(3), number_of, urgent=True)


def test_an_error_of_the_finish_belongs_to_its_request() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()

    def refuse(_: Image, __: PixelField) -> int:
        raise ValueError("nothing static here")

    with pytest.raises(ValueError, match="nothing static"):
        scheduler.submit(image(1), refuse, urgent=True).result(PATIENCE_S)
    assert scheduler.submit(image(2), number_of, urgent=True).result(PATIENCE_S).value == 2
    scheduler.stop()


def test_a_line_of_any_thread_carries_the_request_that_caused_it() -> None:
    seen: list[tuple[str, object]] = []
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, 1, 8)
    scheduler.start()

    def finish(shown: Image, _: PixelField, made: int) -> int:
        seen.append(("finish", fields().get("request_id")))
        return made

    def parallel(shown: Image) -> int:
        seen.append(("parallel", fields().get("request_id")))
        return 1

    futures = []
    for name in ("r1", "r2"):
        with bound(request_id=name):
            futures.append(scheduler.submit(image(1), finish, urgent=name == "r1", parallel=parallel))
    encoder.gate.release(2)
    assert [future.result(PATIENCE_S).value for future in futures] == [1, 1]
    scheduler.stop()
    assert set(seen) == {(stage, name) for stage in ("finish", "parallel") for name in ("r1", "r2")}


@pytest.mark.skipif(sys.platform != "linux", reason="threads have a priority of their own on Linux")
def test_enrolments_are_described_below_queries_and_the_encoder() -> None:
    class Listening(GatedEncoder):
        def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
            encoding.append(own_nice())
            yield from super().encode(images)

    encoding: list[int] = []
    encoder = Listening()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()

    def described(shown: Image, field: PixelField, found: int) -> tuple[int, int]:
        return found, own_nice()

    def made(shown: Image) -> int:
        return own_nice()

    usual = own_nice()
    lower = min(usual + LOWER, 19)
    enrolment = scheduler.submit(image(1), described, urgent=False, parallel=made)
    assert enrolment.result(PATIENCE_S).value == (lower, lower)
    query = scheduler.submit(image(7), described, urgent=True, parallel=made)
    assert query.result(PATIENCE_S).value == (usual, usual)
    assert encoding == [usual, usual]
    scheduler.stop()


def own_nice() -> int:
    """Of the calling thread, 19 being the lowest priority."""
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
