"""Queries come first, one failure is one image's, and stopping serves what was submitted."""

import threading
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pytest

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import Busy, EncoderAway, Unavailable
from schemas.image import Image
from schemas.log_context import bound, fields
from schemas.records import Meaning
from worker.description.scheduler import Scheduler


class GatedEncoder:
    """Encodes one image whenever the test lets it, and remembers the order."""

    name = "gated"
    digest = "0" * 64
    terms = "none"
    layers: Mapping[str, int] = {SEMANTIC: 1}
    known_labels: frozenset[str] | None = None

    def __init__(self) -> None:
        self.seen: list[int] = []
        self.gate = threading.Semaphore(0)
        self.entered = threading.Semaphore(0)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        for image in images:
            self.entered.release()
            self.gate.acquire()
            number = int(image.pixels[0, 0, 0])
            if number == 99:
                raise RuntimeError("this picture kills the network")
            self.seen.append(number)
            yield PixelField({SEMANTIC: np.ones((1, 1, 1), np.float32)}, image.extent)

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        raise AssertionError("not asked here")

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        raise AssertionError("not asked here")


class FinerSegmenter:
    """Sees four cells where the encoder sees one."""

    shared = False

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        return PixelField({SEMANTIC: np.ones((2, 2, 1), np.float32)}, image.extent)


def image(number: int) -> Image:
    return Image.of(np.full((32, 32, 3), number, np.uint8))


def number_of(shown: Image, _: PixelField) -> int:
    return int(shown.pixels[0, 0, 0])


def test_a_query_overtakes_every_enrolment_that_is_not_yet_under_way() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2, 3)]
    encoder.entered.acquire()  # the first enrolment is being encoded
    query = scheduler.submit(image(7), number_of, urgent=True)
    encoder.gate.release(4)

    assert query.result(5).value == 7
    assert [future.result(5).value for future in enrolments] == [1, 2, 3]
    assert encoder.seen == [1, 7, 2, 3]
    scheduler.stop()


def test_a_query_is_answered_while_an_enrolment_is_still_being_described() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    answered = threading.Event()

    def slow(shown: Image, field: PixelField) -> int:
        assert answered.wait(5)
        return number_of(shown, field)

    enrolments = [scheduler.submit(image(n), slow, urgent=False) for n in (1, 2)]
    assert scheduler.submit(image(7), number_of, urgent=True).result(5).value == 7
    answered.set()
    assert [future.result(5).value for future in enrolments] == [1, 2]
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
    assert made.wait(5)  # and the encoder is still held back
    encoder.gate.release()
    assert query.result(5).value == (7, "picture 7")
    scheduler.stop()


def test_a_query_waits_for_nothing_that_runs_in_parallel_for_an_enrolment() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    begun, answered = threading.Event(), threading.Event()

    def slow(_: Image) -> bool:
        begun.set()
        return answered.wait(5)

    enrolment = scheduler.submit(image(1), lambda p, f, waited: waited, urgent=False, parallel=slow)
    assert begun.wait(5)
    query = scheduler.submit(image(7), lambda p, f, keypoints: keypoints, urgent=True, parallel=lambda _: "keypoints")
    assert query.result(3).value == "keypoints"
    answered.set()
    assert enrolment.result(5).value
    scheduler.stop()


def test_a_failure_in_parallel_to_the_encoder_belongs_to_its_request() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()

    def fail(_: Image) -> int:
        raise ValueError("no keypoints today")

    with pytest.raises(ValueError, match="no keypoints"):
        scheduler.submit(image(1), lambda p, f, keypoints: keypoints, urgent=True, parallel=fail).result(5)
    assert scheduler.submit(image(2), number_of, urgent=True).result(5).value == 2
    scheduler.stop()


def test_one_failing_image_does_not_take_its_batch_down() -> None:
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=4, queries=5)
    futures = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 99, 3)]
    encoder.gate.release(9)
    scheduler.start()

    assert futures[0].result(5).value == 1
    with pytest.raises(RuntimeError, match="kills"):
        futures[1].result(5)
    assert futures[2].result(5).value == 3
    scheduler.stop()


def test_more_queries_than_are_let_in_are_refused_with_a_time_to_come_back() -> None:
    scheduler = Scheduler(GatedEncoder(), batch=1, queries=2)
    for number in (1, 2):
        scheduler.submit(image(number), number_of, urgent=True)

    with pytest.raises(Busy, match="2 queries are waiting") as refusal:
        scheduler.submit(image(3), number_of, urgent=True)

    assert refusal.value.retry_after_s >= 1
    scheduler.submit(image(4), number_of, urgent=False)  # enrolments have a queue of their own


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
        scheduler.submit(image(1), refuse, urgent=True).result(5)
    assert scheduler.submit(image(2), number_of, urgent=True).result(5).value == 2
    scheduler.stop()


def test_images_to_be_drawn_get_the_segmenters_field_among_others_that_do_not() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=4, queries=5, segmenter=FinerSegmenter())
    wanted = [(1, False), (2, True), (3, False), (4, False)]

    def number_and_rows(shown: Image, field: PixelField) -> tuple[int, int]:
        return number_of(shown, field), field.shape[0]

    futures = [scheduler.submit(image(n), number_and_rows, urgent=True, segment=segment) for n, segment in wanted]
    scheduler.start()

    assert [future.result(5).value for future in futures] == [(1, 1), (2, 2), (3, 1), (4, 1)]
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
    assert [future.result(10).value for future in futures] == [1, 1]
    scheduler.stop()
    assert set(seen) == {(stage, name) for stage in ("finish", "parallel") for name in ("r1", "r2")}


class AwayEncoder(GatedEncoder):
    """One that is shared, and away until it is said to be there."""

    def __init__(self) -> None:
        super().__init__()
        self.there = False
        self.tried: list[bool] = []
        self.gate.release(99)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        self.tried.append(urgent)
        if not self.there:
            raise EncoderAway("the encoder at http://encoder does not answer", 0)
        yield from super().encode(images)


def test_while_the_encoder_is_away_queries_are_told_and_enrolments_wait() -> None:
    encoder = AwayEncoder()
    scheduler = Scheduler(encoder, batch=2, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2, 3)]
    for number in (7, 8):
        with pytest.raises(EncoderAway, match="does not answer"):
            scheduler.submit(image(number), number_of, urgent=True).result(5)
    later = scheduler.submit(image(4), number_of, urgent=False)
    assert scheduler.away is not None
    assert not any(one.done() for one in [*enrolments, later])

    encoder.there = True
    assert [one.result(5).value for one in [*enrolments, later]] == [1, 2, 3, 4]
    assert encoder.seen == [1, 2, 3, 4]
    assert scheduler.away is None
    assert scheduler.submit(image(9), number_of, urgent=True).result(5).value == 9
    assert {True, False} == set(encoder.tried)
    assert scheduler.queries_waiting == 0
    scheduler.stop()


def test_a_query_that_gets_through_lets_the_enrolments_go_too() -> None:
    class OnceAway(AwayEncoder):
        def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
            if not self.there:
                raise EncoderAway("away for an hour", 3600)
            yield from super().encode(images)

    encoder = OnceAway()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=True).result(5)
    encoder.there = True

    assert scheduler.submit(image(3), number_of, urgent=True).result(5).value == 3
    assert enrolment.result(5).value == 1
    scheduler.stop()


def test_stopping_does_not_wait_for_an_encoder_that_is_away() -> None:
    scheduler = Scheduler(AwayEncoder(), batch=1, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2)]

    scheduler.stop()

    assert [type(one.exception(5)) for one in enrolments] == [EncoderAway, EncoderAway]


def test_an_image_that_is_to_be_blurred_does_not_wait_for_an_encoder_that_is_away() -> None:
    encoder = AwayEncoder()
    scheduler = Scheduler(encoder, batch=3, queries=5, segmenter=FinerSegmenter())
    blurred = [scheduler.submit(image(1), number_of, urgent=False, segment=True)]
    described = [scheduler.submit(image(2), number_of, urgent=False)]  # in one batch with what is to be blurred
    blurred.append(scheduler.submit(image(3), number_of, urgent=False, segment=True))
    scheduler.start()
    assert [one.result(5).value for one in blurred] == [1, 3]
    described.append(scheduler.submit(image(4), number_of, urgent=False))
    later = scheduler.submit(image(5), number_of, urgent=False, segment=True)

    assert later.result(5).value == 5
    assert not any(one.done() for one in described)
    encoder.there = True
    assert [one.result(5).value for one in described] == [2, 4]
    scheduler.stop()


def test_a_drawing_says_nothing_of_an_encoder_that_is_away() -> None:
    encoder = AwayEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5, segmenter=FinerSegmenter())
    scheduler.start()
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=True).result(5)

    assert scheduler.submit(image(3), number_of, urgent=True, segment=True).result(5).value == 3
    assert scheduler.away is not None
    assert not enrolment.done()
    scheduler.stop()


class SharedSegmenter(FinerSegmenter):
    """One of a shared encoder."""

    shared = True

    def __init__(self) -> None:
        self.there = False
        self.urgent: list[bool] = []

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        self.urgent.append(urgent)
        if not self.there:
            raise EncoderAway("its segmenter does not answer", 0)
        return super().segment(image)


def test_while_a_shared_segmenter_is_away_only_segmentations_are_told_or_wait() -> None:
    encoder, segmenter = AwayEncoder(), SharedSegmenter()
    encoder.there = True
    scheduler = Scheduler(encoder, batch=4, queries=5, segmenter=segmenter)
    patient = scheduler.submit(image(1), number_of, urgent=False, segment=True)
    hurried = scheduler.submit(image(2), number_of, urgent=False, segment=True, waits=False)
    described = scheduler.submit(image(3), number_of, urgent=False)  # in one batch with them
    scheduler.start()

    with pytest.raises(EncoderAway, match="segmenter"):
        hurried.result(5)
    with pytest.raises(EncoderAway, match="segmenter"):
        scheduler.submit(image(4), number_of, urgent=True, segment=True).result(5)
    assert described.result(5).value == 3
    assert scheduler.submit(image(5), number_of, urgent=True).result(5).value == 5
    assert scheduler.away is None
    assert not patient.done()
    assert set(segmenter.urgent) == {True, False}
    segmenter.there = True
    assert patient.result(5).value == 1
    scheduler.stop()


def test_an_image_that_may_not_wait_is_told_at_once_that_the_encoder_is_away() -> None:
    scheduler = Scheduler(AwayEncoder(), batch=1, queries=5)
    scheduler.start()
    waiting = scheduler.submit(image(1), number_of, urgent=False)

    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=False, waits=False).result(5)

    assert not waiting.done()
    scheduler.stop()
