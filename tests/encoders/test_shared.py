"""A shared encoder gives what one in the process gives; whatever happens to it costs a query little time."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Protocol, TypeVar

import numpy as np
import pytest

from schemas.errors import EncoderAway, SetupError
from schemas.image import Image
from schemas.inference import Tensor
from schemas.settings import Settings
from tests.encoders.inference_server import (
    SHORT_S,
    Answer,
    Handler,
    InferenceServer,
    breaks_off,
    floods,
    hangs,
    says,
    trickles,
)
from tests.sample_images import drawn
from tests.waiting import PATIENCE_S
from worker.encoders.choosing import batch_of, make_encoder, patience_of
from worker.encoders.compact.encoder import CompactEncoder, weights_named
from worker.encoders.compact.ensemble import digest_of
from worker.encoders.compact.shared import SharedCompactEncoder, SharedSegmenter
from worker.encoders.inference_client import SEGMENTED_WITHIN, FailedImage, InferenceClient

C = TypeVar("C", SharedCompactEncoder, InferenceClient)


class Opened(Protocol):
    """Has one closed at the end of a test."""

    def __call__(self, one: C) -> C:
        """The same."""
        ...


SIZES = ((640, 480), (640, 480), (300, 400), (97, 97), (64, 48))


@pytest.fixture(scope="module")
def local() -> CompactEncoder:
    return CompactEncoder()


@pytest.fixture
def server() -> Iterator[InferenceServer]:
    with InferenceServer() as serving:
        thread = threading.Thread(target=serving.serve_forever, args=(0.01,))
        thread.start()
        yield serving
        serving.shutdown()
        thread.join()


@pytest.fixture
def segmenting() -> Iterator[InferenceServer]:
    with InferenceServer(segments=True) as serving:
        thread = threading.Thread(target=serving.serve_forever, args=(0.01,))
        thread.start()
        yield serving
        serving.shutdown()
        thread.join()


@pytest.fixture
def client(server: InferenceServer) -> Iterator[InferenceClient]:
    one = InferenceClient(server.url, "compact-1", CHANNELS, None, PATIENCE_S)
    yield one
    one.close()


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Has one closed at the end of a test, of one that fails too: what stays open fails a later test."""
    with ExitStack() as stack:

        def opened(one: C) -> C:
            return stack.enter_context(closing(one))

        yield opened


PIXELS = np.zeros((2, 96, 128, 3), np.uint8)
CHANNELS = {"semantic": 97, "detail": 64}


def test_every_layer_is_the_same_to_the_byte(server: InferenceServer, local: CompactEncoder, opened: Opened) -> None:
    images = [Image.of(drawn(*size, seed)) for seed, size in enumerate(SIZES)]
    shared = opened(SharedCompactEncoder(server.url, None, PATIENCE_S))

    found = list(shared.encode(images, urgent=True))

    assert (shared.name, shared.digest, shared.layers) == (local.name, local.digest, local.layers)
    for mine, other in zip(found, local.encode(images), strict=True):
        assert mine.extent == other.extent
        assert list(mine.layers) == list(other.layers)
        for name, layer in other.layers.items():
            assert mine.layers[name].dtype == layer.dtype
            assert mine.layers[name].tobytes() == layer.tobytes()
    shapes = [shape for _, _, _, shape in server.received[1:]]  # the first call was the trial at the start
    # Two calls are under way at a time, and may arrive the other way round.
    assert sorted(shapes) == sorted([(2, 352, 480, 3), (1, 480, 352, 3), (1, 352, 352, 3), (1, 256, 352, 3)])
    assert server.received[-1][0] == f"/v2/models/compact-{local.digest[:12]}/infer"


@pytest.mark.parametrize("size", [(320, 240), (1000, 300), (60, 97)])
def test_what_is_drawn_is_the_same_to_the_byte_and_no_network_is_loaded(
    segmenting: InferenceServer,
    local: CompactEncoder,
    size: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
    opened: Opened,
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # a node needs nothing that runs networks
    shared = opened(SharedCompactEncoder(segmenting.url, None, PATIENCE_S))
    image = Image.of(drawn(*size))
    mine, other = shared.segmenter(), local.segmenter()

    assert mine is not None
    assert other is not None
    here, there = other.segment(image), mine.segment(image)
    assert (there.semantic.tobytes(), there.extent) == (here.semantic.tobytes(), here.extent)
    assert segmenting.received[-1][0] == f"/v2/models/compact-segmenter-{local.segmenter_digest[:12]}/infer"


def test_where_it_has_no_segmenter_the_drawings_are_made_here(
    server: InferenceServer, local: CompactEncoder, caplog: pytest.LogCaptureFixture, opened: Opened
) -> None:
    shared = opened(SharedCompactEncoder(server.url, None, PATIENCE_S))
    server.answer = says(503)
    image = Image.of(drawn(320, 240))
    mine, other = shared.segmenter(), local.segmenter()

    assert "makes no segmentations as this version does; they are made here" in caplog.text
    assert mine is not None
    assert other is not None
    assert not isinstance(mine, SharedSegmenter)
    assert np.array_equal(mine.segment(image).semantic, other.segment(image).semantic)


def test_a_segmenter_that_fails_is_left_alone_for_a_second_and_the_encoder_is_not(
    segmenting: InferenceServer, monkeypatch: pytest.MonkeyPatch, opened: Opened
) -> None:
    shared = opened(SharedCompactEncoder(segmenting.url, None, PATIENCE_S))
    now = time.monotonic()
    monkeypatch.setattr(shared._client, "_clock", lambda: now)
    image, segmenter = Image.of(drawn(64, 48)), shared.segmenter()
    assert segmenter is not None

    def no_segmentations(handler: Handler, tensors: dict[str, Tensor]) -> None:
        (segmenting.right if "pictures" in tensors else says(503))(handler, tensors)

    segmenting.answer = no_segmentations
    for passed_s, calls in ((0, 1), (0, 1), (0, 1), (1.1, 2)):
        now += passed_s
        with pytest.raises(EncoderAway, match="answers 503"):
            segmenter.segment(image)
        assert next(shared.encode([image])).shape == (32, 44)
        assert sum("-segmenter-" in path for path, _, _, _ in segmenting.received) == calls


def test_a_segmentation_may_take_twice_as_long_to_begin(segmenting: InferenceServer, opened: Opened) -> None:
    shared = opened(SharedCompactEncoder(segmenting.url, None, PATIENCE_S))
    image, segmenter = Image.of(drawn(64, 48)), shared.segmenter()
    assert segmenter is not None
    shared._client._patience_s = SHORT_S
    segmenting.answer = hangs

    with pytest.raises(EncoderAway, match=f"does not answer within {2 * SHORT_S:.1f} s"):
        segmenter.segment(image)

    parameters = segmenting.received[-1][1]["parameters"]
    assert isinstance(parameters, dict)
    assert parameters["timeout"] == 2 * SHORT_S * 1_000_000


def test_all_that_decides_a_drawing_is_in_its_name() -> None:
    assert digest_of(["a", "b"]) != digest_of(["a"])
    assert digest_of(["a", "b"]) != digest_of(["b", "a"])


def test_labels_stay_in_the_process(server: InferenceServer, local: CompactEncoder, opened: Opened) -> None:
    shared = opened(SharedCompactEncoder(server.url, None, PATIENCE_S))
    server.answer = says(503)
    assert np.array_equal(shared.text_vectors(["road"]), local.text_vectors(["road"]))
    assert shared.meanings(["road"]) == local.meanings(["road"])


def test_a_query_says_that_it_goes_first_and_how_long_it_waits(server: InferenceServer, opened: Opened) -> None:
    client = opened(InferenceClient(server.url, "compact-1", CHANNELS, "a key of the fleet", 20.0))
    for urgent in (True, False):
        client.fields(PIXELS, urgent=urgent)

    received = [said["parameters"] for _, said, _, _ in server.received]
    assert received == [{"binary_data_output": True, "priority": p, "timeout": 20_000_000} for p in (1, 2)]
    assert {key for _, _, key, _ in server.received} == {"Bearer a key of the fleet"}


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (hangs, "does not answer within 0.5 s"),
        (trickles, "does not answer within 0.5 s"),
        (floods, "answers more than "),
        (breaks_off, "cannot be reached"),
        (says(503), "answers 503: so it says"),
        (says(502, "<html>"), "answers 502: <html>"),
        (says(200, "fine"), "gives an answer of another kind"),
        (says(200, '{"outputs": []}'), "the output words of 2 images is None"),
        (says(500), "fails on a test image"),
        (says(404, '{"error": "unknown model", "detail": "d"}'), "does not have the model compact-1"),
        (says(401, '{"detail": "no"}'), "refuses the key"),
    ],
)
def test_whatever_is_wrong_with_it_is_said_by_name_and_soon(server: InferenceServer, answer: Answer, why: str) -> None:
    server.answer = answer
    patience_s = SHORT_S if answer in (hangs, trickles) else PATIENCE_S
    began = time.monotonic()

    with (
        closing(InferenceClient(server.url, "compact-1", CHANNELS, None, patience_s)) as client,
        pytest.raises(EncoderAway) as away,
    ):
        client.fields(PIXELS, urgent=True)

    assert time.monotonic() - began < 20 * SHORT_S, "a whole answer takes twice as long to trickle in"
    assert why in away.value.detail
    assert f"the encoder at {server.url} " in away.value.detail


def test_after_a_failure_calls_fail_at_once_until_a_small_image_is_encoded(
    server: InferenceServer, opened: Opened
) -> None:
    now = [0.0]
    client = opened(InferenceClient(server.url, "compact-1", CHANNELS, None, PATIENCE_S, clock=lambda: now[0]))
    server.answer = says(503, Retry_After="4")
    with pytest.raises(EncoderAway) as away:
        client.fields(PIXELS, urgent=True)
    assert away.value.retry_after_s == 4

    for now[0] in (1.0, 3.9):
        with pytest.raises(EncoderAway, match="answers 503"):
            client.fields(PIXELS, urgent=True)
    assert len(server.received) == 1  # it was left alone
    now[0] = 4.0
    with pytest.raises(EncoderAway):
        client.fields(PIXELS, urgent=True)
    assert server.received[1][3] == (1, 96, 96, 3)

    server.answer = server.right
    now[0] = 8.0
    assert client.fields(PIXELS, urgent=True)["semantic"].shape[:3] == (2, 12, 16)
    assert client.fields(PIXELS, urgent=True)["semantic"].shape[:3] == (2, 12, 16)
    assert [shape for _, _, _, shape in server.received[2:]] == [(1, 96, 96, 3), PIXELS.shape, PIXELS.shape]


def test_one_that_stops_is_followed_by_another_at_the_same_address(
    server: InferenceServer, client: InferenceClient
) -> None:
    def stops(handler: Handler, tensors: dict[str, Tensor]) -> None:
        server.answer = server.right
        handler.close_connection = True
        handler.give(503, b"{}", Connection="close", Retry_After="10")

    server.answer = stops

    assert len(client.fields(PIXELS, urgent=True)["semantic"]) == 2
    server.answer = says(503, Retry_After="600")
    with pytest.raises(EncoderAway) as away:
        client.fields(PIXELS, urgent=True)
    assert away.value.retry_after_s == 5


def test_images_on_which_a_sound_encoder_fails_are_to_blame_themselves(
    server: InferenceServer, client: InferenceClient
) -> None:
    def fails_on_two(handler: Handler, tensors: dict[str, Tensor]) -> None:
        (says(500) if len(tensors["pictures"]) == 2 else server.right)(handler, tensors)

    server.answer = fails_on_two

    with pytest.raises(FailedImage, match="answers 500: so it says"):
        client.fields(PIXELS, urgent=False)
    assert len(client.fields(PIXELS[:1], urgent=False)["detail"]) == 1


def test_a_connection_that_was_closed_meanwhile_is_made_anew(server: InferenceServer, client: InferenceClient) -> None:
    def closes(handler: Handler, tensors: dict[str, Tensor]) -> None:
        server.right(handler, tensors)
        handler.close_connection = True  # without saying so

    server.answer = closes

    for _ in range(3):
        assert len(client.fields(PIXELS, urgent=False)["semantic"]) == 2


@pytest.mark.parametrize(("status", "why"), [(404, "weights"), (400, "weights"), (403, "REVISIT_ENCODER_KEY")])
def test_other_weights_and_another_key_are_refused_at_the_start(server: InferenceServer, status: int, why: str) -> None:
    server.answer = says(status)

    with pytest.raises(SetupError, match=why):
        SharedCompactEncoder(server.url, None, PATIENCE_S)


def test_one_that_is_away_at_the_start_is_waited_for(server: InferenceServer, opened: Opened) -> None:
    server.answer = says(503)
    shared = opened(SharedCompactEncoder(server.url, None, PATIENCE_S))
    image = Image.of(drawn(64, 48))
    with pytest.raises(EncoderAway):
        next(shared.encode([image]))

    server.answer = server.right
    time.sleep(1.1)
    assert next(shared.encode([image])).shape == (32, 44)


def test_weights_by_another_name_are_shared_too(server: InferenceServer, opened: Opened) -> None:
    server.encoder = CompactEncoder(weights=weights_named("compact-open"), prepared=True)
    shared, segmenter = make_encoder(Settings(encoder="compact-open", encoder_url=server.url), 1)
    assert isinstance(shared, SharedCompactEncoder)
    opened(shared)
    assert segmenter is None
    image = Image.of(drawn(640, 480))
    here = CompactEncoder(weights=weights_named("compact-open"))
    [field], [own] = shared.encode([image]), here.encode([image])
    assert all((field.layers[name] == own.layers[name]).all() for name in own.layers)
    assert f"/compact-open-{here.digest[:12]}/" in server.received[-1][0]


def test_only_the_built_in_encoders_are_shared() -> None:
    with pytest.raises(SetupError, match="compact or compact-open alone"):
        make_encoder(Settings(encoder="color", encoder_url="http://encoder:8100"), 1)


def test_all_parts_of_a_call_together_take_less_than_callers_wait() -> None:
    for wait in (4.0, 30.0, 120.0):
        patience_s = patience_of(Settings(wait=wait))
        assert 3 * patience_s < wait
        assert (2 + SEGMENTED_WITHIN) * patience_s <= wait
    assert batch_of(Settings()) == 1
    assert batch_of(Settings(encoder_url="http://encoder:8100")) > 1
