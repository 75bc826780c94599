"""A batch goes to a shared encoder as two calls at a time, and comes back as if it had been one."""

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from schemas.description import PixelField
from schemas.errors import EncoderAway
from schemas.image import Image
from schemas.inference import Tensor
from tests.encoders.inference_server import Handler, InferenceServer, says
from tests.encoders.test_shared import local, server
from tests.sample_images import drawn
from tests.waiting import PATIENCE_S, until
from worker.description.scheduler import Scheduler, field_alone
from worker.encoders.compact.encoder import CompactEncoder
from worker.encoders.compact.input_size import resized
from worker.encoders.compact.shared import SharedCompactEncoder
from worker.encoders.inference_client import FailedImage

__all__ = ["local", "server"]

EIGHT = [Image.of(drawn(64, 16, seed)) for seed in range(8)]
SENT_FIRST = resized(EIGHT[0].pixels)
FIRST_HALF = 4


@pytest.fixture
def shared(server: InferenceServer) -> Iterator[SharedCompactEncoder]:
    one = SharedCompactEncoder(server.url, None, 4 * PATIENCE_S)  # more than what holds its calls
    server.received.clear()
    yield one
    one.close()


class Meeting:
    """Answers rightly; counts how many calls are there at a time, and holds each for a moment.

    The first calls wait for one another, or with `second_first` the first one for the answer to another, so that a busy
    machine does not keep them from meeting.
    """

    def __init__(self, server: InferenceServer, *, second_first: bool = False) -> None:
        self._server, self._second_first = server, second_first
        self._lock = threading.Lock()
        self._met, self._answered = threading.Event(), threading.Event()
        self._here = 0
        self.most = 0
        self.ended: list[int] = []

    def __call__(self, handler: Handler, tensors: dict[str, Tensor]) -> None:
        with self._lock:
            self._here += 1
            self.most = max(self.most, self._here)
            if self._here > 1:
                self._met.set()
        first = np.array_equal(tensors["pictures"][0], SENT_FIRST)
        self._met.wait(PATIENCE_S)
        if first and self._second_first:
            self._answered.wait(PATIENCE_S)
        time.sleep(0.05)
        with self._lock:
            self._here -= 1
            self.ended.append(0 if first else 1)
            self._answered.set()
        self._server.right(handler, tensors)


def same(found: list[PixelField], wanted: list[PixelField]) -> bool:
    return [{name: layer.tobytes() for name, layer in field.layers.items()} for field in found] == [
        {name: layer.tobytes() for name, layer in field.layers.items()} for field in wanted
    ]


def test_fields_come_in_order_though_the_second_call_is_answered_first(
    server: InferenceServer, shared: SharedCompactEncoder, local: CompactEncoder
) -> None:
    meeting = server.answer = Meeting(server, second_first=True)
    assert same(list(shared.encode(EIGHT)), list(local.encode(EIGHT)))
    assert (meeting.most, meeting.ended) == (2, [1, 0])
    assert [shape[0] for _, _, _, shape in server.received] == [4, 4]


def test_no_more_than_two_calls_are_under_way(
    server: InferenceServer, shared: SharedCompactEncoder, local: CompactEncoder
) -> None:
    meeting = server.answer = Meeting(server)
    images = [*EIGHT, Image.of(drawn(48, 64)), Image.of(drawn(97, 97)), *EIGHT[:3]]
    assert same(list(shared.encode(images)), list(local.encode(images)))
    assert meeting.most == 2
    assert sorted(shape[0] for _, _, _, shape in server.received) == [1, 1, 3, 4, 4]


def test_a_lone_image_is_one_call_of_this_thread(server: InferenceServer, shared: SharedCompactEncoder) -> None:
    assert len(list(shared.encode(EIGHT[:1], urgent=True))) == 1
    assert len(server.received) == 1
    assert not [one.name for one in threading.enumerate() if one.name.startswith("revisit-sending")]


@pytest.mark.parametrize(("fails", "before"), [(0, 0), (1, FIRST_HALF)])
def test_a_call_that_fails_raises_in_the_place_of_its_first_image(
    server: InferenceServer, shared: SharedCompactEncoder, fails: int, before: int
) -> None:
    sent = threading.Event()  # the first call: it would not be sent once the second has failed

    def one_fails(handler: Handler, tensors: dict[str, Tensor]) -> None:
        first = np.array_equal(tensors["pictures"][0], SENT_FIRST)
        if first:
            sent.set()
        assert sent.wait(30)
        (says(503) if first == (fails == 0) else server.right)(handler, tensors)

    server.answer = one_fails
    fields = shared.encode(EIGHT)
    assert len([next(fields) for _ in range(before)]) == before
    with pytest.raises(EncoderAway, match="answers 503"):
        next(fields)

    server.answer = server.right
    time.sleep(1.1)
    assert len(list(shared.encode(EIGHT))) == 8


def test_one_image_on_which_it_fails_does_not_fail_the_others(
    server: InferenceServer, shared: SharedCompactEncoder
) -> None:
    def fails_on_it(handler: Handler, tensors: dict[str, Tensor]) -> None:
        hit = any(np.array_equal(one, SENT_FIRST) for one in tensors["pictures"])
        (says(500) if hit else server.right)(handler, tensors)

    server.answer = fails_on_it
    scheduler = Scheduler(shared, 8, 8)
    sent = [scheduler.submit(image, field_alone, urgent=False) for image in EIGHT]
    scheduler.start()
    failed = [one.exception(30) for one in sent]
    scheduler.stop()
    assert isinstance(failed[0], FailedImage)
    assert failed[1:] == [None] * 7


def test_a_query_goes_before_the_enrolments_that_wait(server: InferenceServer, shared: SharedCompactEncoder) -> None:
    queried, answered = threading.Event(), threading.Event()

    def holds(handler: Handler, tensors: dict[str, Tensor]) -> None:
        """The first two calls until there is a query, and those after the third until that is answered."""
        number = len(server.received)
        if number != 3:
            (queried if number < 3 else answered).wait(PATIENCE_S)
        server.right(handler, tensors)

    server.answer = holds
    scheduler = Scheduler(shared, 8, 8)
    sent = [scheduler.submit(image, field_alone, urgent=False) for image in EIGHT * 2]
    scheduler.start()
    until(lambda: len(server.received) >= 2)
    query = scheduler.submit(EIGHT[3], field_alone, urgent=True)
    queried.set()
    query.result(30)
    assert not sent[-1].done()
    answered.set()
    for one in sent:
        one.result(30)
    scheduler.stop()
    priorities = [said["parameters"]["priority"] for _, said, _, _ in server.received]  # type: ignore[index]
    assert priorities == [2, 2, 1, 2, 2]
