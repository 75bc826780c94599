"""While a shared encoder is away, or the one of this process fails, queries are told and enrolments wait for it."""

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from schemas.description import SEMANTIC, PixelField
from schemas.errors import EncoderAway, EncoderFails
from schemas.image import Image
from tests.description.gated import GatedEncoder, image, number_of
from tests.waiting import PATIENCE_S, until
from worker.description import blame
from worker.description.scheduler import Scheduler, segmenting
from worker.description.trial import tried


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
            scheduler.submit(image(number), number_of, urgent=True).result(PATIENCE_S)
    later = scheduler.submit(image(4), number_of, urgent=False)
    assert scheduler.away is not None
    assert not any(one.done() for one in [*enrolments, later])

    encoder.there = True
    assert [one.result(PATIENCE_S).value for one in [*enrolments, later]] == [1, 2, 3, 4]
    assert encoder.seen == [1, 2, 3, 4]
    assert scheduler.away is None
    assert scheduler.submit(image(9), number_of, urgent=True).result(PATIENCE_S).value == 9
    assert {True, False} == set(encoder.tried)
    until(lambda: scheduler.queries_waiting == 0)  # a query is counted until just after its answer
    scheduler.stop()


class LongAway(AwayEncoder):
    """One that need not be tried again soon."""

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        if not self.there:
            raise EncoderAway("away for an hour", 3600)
        yield from super().encode(images)


def test_a_query_that_gets_through_lets_the_enrolments_go_too() -> None:
    encoder = LongAway()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=True).result(PATIENCE_S)
    encoder.there = True

    assert scheduler.submit(image(3), number_of, urgent=True).result(PATIENCE_S).value == 3
    assert enrolment.result(PATIENCE_S).value == 1
    scheduler.stop()


def test_stopping_does_not_wait_for_an_encoder_that_is_away() -> None:
    scheduler = Scheduler(AwayEncoder(), batch=1, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2)]

    scheduler.stop()

    assert [type(one.exception(PATIENCE_S)) for one in enrolments] == [EncoderAway, EncoderAway]


def test_where_nobody_has_time_to_wait_what_was_held_back_fails_at_once() -> None:
    scheduler = Scheduler(LongAway(), batch=1, queries=5)
    scheduler.start()
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=True).result(PATIENCE_S)
    assert not enrolment.done()

    scheduler.stop_waiting()

    assert type(enrolment.exception(PATIENCE_S)) is EncoderAway
    scheduler.stop()


class AwaySegmenter:
    """One that cannot be had until it is said to be there."""

    def __init__(self, error: Exception) -> None:
        self.there = False
        self.urgent: list[bool] = []
        self._error = error

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        self.urgent.append(urgent)
        if not self.there:
            raise self._error
        return PixelField({SEMANTIC: np.ones((2, 2, 1), np.float32)}, image.extent)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (EncoderAway("its segmenter does not answer", 0), "its segmenter does not answer"),
        (RuntimeError("CUDA error: unspecified launch failure"), "the segmenter fails on every image"),
    ],
)
def test_while_a_segmenter_is_away_drawings_are_told_and_what_is_to_be_blurred_may_wait(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(blame, "REST_S", 0)
    segmenter = AwaySegmenter(error)
    scheduler = segmenting(segmenter, 5)
    patient = scheduler.submit(image(1), number_of, urgent=False)
    hurried = scheduler.submit(image(2), number_of, urgent=False, waits=False)
    scheduler.start()

    with pytest.raises(EncoderAway, match=said):
        hurried.result(PATIENCE_S)
    with pytest.raises(EncoderAway, match=said):
        scheduler.submit(image(4), number_of, urgent=True).result(PATIENCE_S)
    assert not patient.done()
    assert set(segmenter.urgent) == {True, False}
    segmenter.there = True
    assert patient.result(PATIENCE_S).value == 1
    scheduler.stop()
    events = [record.__dict__.get("event") for record in caplog.records]
    assert (events[0], events[-1]) == ("segmenter_away", "segmenter_back")
    assert "segmentations are refused or wait" in caplog.records[0].getMessage()


def test_an_image_that_may_not_wait_is_told_at_once_that_the_encoder_is_away() -> None:
    scheduler = Scheduler(AwayEncoder(), batch=1, queries=5)
    scheduler.start()
    waiting = scheduler.submit(image(1), number_of, urgent=False)

    with pytest.raises(EncoderAway):
        scheduler.submit(image(2), number_of, urgent=False, waits=False).result(PATIENCE_S)

    assert not waiting.done()
    scheduler.stop()


class IllEncoder(GatedEncoder):
    """Fails on every image, as on a GPU that is lost, until it is said to be well."""

    def __init__(self) -> None:
        super().__init__()
        self.well = False
        self.gate.release(99)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        if not self.well:
            raise RuntimeError("CUDA error: an illegal memory access was encountered")
        yield from super().encode(images)


class RecoveringEncoder(GatedEncoder):
    """Fails once, on the second image that it is given."""

    def __init__(self) -> None:
        super().__init__()
        self.given = 0
        self.gate.release(99)

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        for one in images:
            self.given += 1
            if self.given == 2:
                raise RuntimeError("CUDA error: out of memory")
            yield from super().encode([one])


class OverflowingEncoder(GatedEncoder):
    """Gives vectors of a bright image that are none."""

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        for one, field in zip(images, super().encode(images), strict=True):
            if one.pixels[0, 0, 0] == 255:
                field.semantic[:] = np.nan
            yield field


def test_while_the_encoder_fails_on_every_image_none_is_to_blame(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.description.blame.REST_S", 0)
    encoder = IllEncoder()
    scheduler = Scheduler(encoder, batch=2, queries=5)
    scheduler.start()
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2, 3)]
    for number in (7, 8):
        with pytest.raises(EncoderFails, match=r"fails on every image \(RuntimeError\)"):
            scheduler.submit(image(number), number_of, urgent=True).result(PATIENCE_S)
    assert "fails on every image" in tried(scheduler, PATIENCE_S)
    assert not any(one.done() for one in enrolments)
    assert scheduler.beyond_help is None  # it may get well
    told = [line for line in caplog.records if line.message.startswith("the encoder fails on every image")]
    assert len(told) == 1
    assert "illegal memory access" in str(told[0].exc_info)

    encoder.well = True
    assert [one.result(PATIENCE_S).value for one in enrolments] == [1, 2, 3]
    assert tried(scheduler, PATIENCE_S) == "ok"
    scheduler.stop()


@pytest.mark.parametrize("batch", [1, 3])
def test_an_encoder_that_is_well_again_before_it_is_tried_on_a_plain_image_blames_none(batch: int) -> None:
    encoder = RecoveringEncoder()
    scheduler = Scheduler(encoder, batch=batch, queries=5)
    enrolments = [scheduler.submit(image(n), number_of, urgent=False) for n in (1, 2, 3)]
    scheduler.start()

    assert [one.result(PATIENCE_S).value for one in enrolments] == [1, 2, 3]
    assert encoder.seen == [1, 127, 2, 3], "each once, and the plain one between"
    assert scheduler.away is None
    scheduler.stop()


def test_an_encoder_that_fails_for_a_minute_is_beyond_help_until_it_encodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.description.scheduler.HOPELESS_S", 0.05)
    monkeypatch.setattr("worker.description.blame.REST_S", 0)
    encoder = IllEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    until(lambda: scheduler.beyond_help == "the encoder has failed on every image for 0 s")

    encoder.well = True
    assert enrolment.result(PATIENCE_S).value == 1
    assert scheduler.beyond_help is None
    scheduler.stop()
    assert scheduler.beyond_help == "the encoder's thread has ended"


def test_an_encoder_that_hangs_for_minutes_is_beyond_help_until_it_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.description.scheduler.HANGS_S", 0.05)
    encoder = GatedEncoder()
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    assert scheduler.beyond_help is None, "there is nothing to encode"
    enrolment = scheduler.submit(image(1), number_of, urgent=False)
    until(lambda: scheduler.beyond_help == "the encoder has been at one image for 0 s")

    encoder.gate.release()
    assert enrolment.result(PATIENCE_S).value == 1
    until(lambda: scheduler.beyond_help is None)
    scheduler.stop()


def test_a_shared_encoder_that_is_away_is_not_beyond_the_help_of_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.description.scheduler.HOPELESS_S", 0.0)
    scheduler = Scheduler(AwayEncoder(), batch=1, queries=5)
    scheduler.start()
    for number in (1, 2):
        with pytest.raises(EncoderAway):
            scheduler.submit(image(number), number_of, urgent=True).result(PATIENCE_S)

    assert scheduler.beyond_help is None
    scheduler.stop()


def test_an_image_on_which_alone_the_encoder_fails_does_not_keep_others_waiting() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=1, queries=5)
    scheduler.start()
    with pytest.raises(RuntimeError, match="kills"):
        scheduler.submit(image(99), number_of, urgent=False).result(PATIENCE_S)

    assert scheduler.away is None
    assert scheduler.submit(image(1), number_of, urgent=False).result(PATIENCE_S).value == 1
    scheduler.stop()


def test_an_image_whose_vectors_are_none_fails_alone() -> None:
    encoder = OverflowingEncoder()
    encoder.gate.release(9)
    scheduler = Scheduler(encoder, batch=2, queries=5)
    futures = [scheduler.submit(image(number), number_of, urgent=False) for number in (1, 255, 3)]
    scheduler.start()

    with pytest.raises(ValueError, match="numbers that are none"):
        futures[1].result(PATIENCE_S)
    assert [futures[n].result(PATIENCE_S).value for n in (0, 2)] == [1, 3]
    assert scheduler.away is None
    scheduler.stop()
