"""A shared encoder whose network is broken, of which nothing is stored or drawn; one that fails on an image alone."""

from collections.abc import Callable

import numpy as np
import pytest

from schemas.errors import EncoderAway
from schemas.image import Image
from schemas.inference import JSON_LENGTH, Tensor, packed
from tests.encoders.inference_server import Answer, Handler, InferenceServer, says
from tests.encoders.test_shared import PIXELS, client, segmenting, server
from tests.sample_images import drawn
from tests.waiting import PATIENCE_S
from worker.encoders.compact.shared import SharedCompactEncoder
from worker.encoders.inference_client import FailedImage, InferenceClient

__all__ = ["client", "segmenting", "server"]


def field(count: int, rows: int, columns: int, channels: int) -> Tensor:
    ones = np.ones((count, rows, columns, channels), np.float32)
    return np.asarray(ones / np.sqrt(channels), np.float32)


def with_one(value: float) -> Callable[[Tensor], Tensor]:
    def changed(layer: Tensor) -> Tensor:
        layer[-1, -1, -1, -1] = value
        return layer

    return changed


def gives(layers: dict[str, Tensor]) -> Answer:
    length, body = packed("outputs", layers, {})
    return lambda handler, _: handler.give(200, body, **{JSON_LENGTH.replace("-", "_"): str(length)})


def through(broken: Callable[[Tensor], Tensor], at_least: int = 1) -> Answer:
    """Answers as a network whose numbers are broken, for so many images or more."""

    def answer(handler: Handler, tensors: dict[str, Tensor]) -> None:
        count, height, width, _ = tensors["pictures"].shape
        layers = {
            name: field(count, height // 8, width // 8, channels) for name, channels in (("words", 97), ("detail", 64))
        }
        gives({name: broken(layer) for name, layer in layers.items()} if count >= at_least else layers)(
            handler, tensors
        )

    return answer


BROKEN = [
    with_one(np.nan),
    with_one(np.inf),
    np.zeros_like,
    lambda layer: np.asarray(layer * 1e30, np.float32),
    lambda layer: np.asarray(layer * 1.02, np.float32),
]


@pytest.mark.parametrize("broken", BROKEN)
def test_one_whose_numbers_are_broken_is_away(
    server: InferenceServer, client: InferenceClient, broken: Callable[[Tensor], Tensor]
) -> None:
    server.answer = through(broken)
    with pytest.raises(EncoderAway, match=r"fails on a test image \(.* not of unit length"):
        client.fields(PIXELS, urgent=True)


@pytest.mark.parametrize("broken", BROKEN)
def test_images_for_which_a_sound_encoder_gives_no_field_are_to_blame_themselves(
    server: InferenceServer, client: InferenceClient, broken: Callable[[Tensor], Tensor]
) -> None:
    server.answer = through(broken, at_least=2)
    with pytest.raises(FailedImage, match="vectors in words that are not of unit length"):
        client.fields(PIXELS, urgent=False)
    assert len(client.fields(PIXELS[:1], urgent=False)["detail"]) == 1


def test_numbers_of_half_the_precision_will_do(server: InferenceServer, client: InferenceClient) -> None:
    server.answer = through(lambda layer: np.asarray(layer.astype(np.float16), np.float32))
    assert len(client.fields(PIXELS, urgent=True)["semantic"]) == 2


@pytest.mark.parametrize(
    ("words", "detail"),
    [
        ((2, 1, 1, 97), (2, 12, 16, 64)),
        ((2, 12, 16, 97), (2, 16, 12, 64)),
        ((2, 12, 16, 64), (2, 12, 16, 64)),
        ((2, 12, 16, 97), (2, 12, 16, 97)),
    ],
)
def test_one_whose_fields_have_another_shape_is_away(
    server: InferenceServer, client: InferenceClient, words: tuple[int, ...], detail: tuple[int, ...]
) -> None:
    server.answer = gives({"words": field(*words), "detail": field(*detail)})
    with pytest.raises(EncoderAway, match=r"another kind: the output (words|detail) of 2 images is"):
        client.fields(PIXELS, urgent=True)


@pytest.mark.parametrize("answer", [says(429, "[" * 100_000), says(503, Retry_After="9" * 5_000)])
def test_whatever_a_refusal_says_it_is_one(server: InferenceServer, client: InferenceClient, answer: Answer) -> None:
    server.answer = answer
    with pytest.raises(EncoderAway) as away:
        client.fields(PIXELS, urgent=True)
    assert away.value.retry_after_s in (1, 5)


@pytest.mark.parametrize(
    ("segmentation", "error", "why"),
    [
        (with_one(np.nan)(field(1, 88, 120, 97)), FailedImage, "vectors in segmentation that are not of unit length"),
        (field(1, 120, 88, 97), EncoderAway, "the output segmentation of 1 images is"),
    ],
)
def test_nothing_is_drawn_or_blurred_by_a_segmentation_that_is_none(
    segmenting: InferenceServer, segmentation: Tensor, error: type[Exception], why: str
) -> None:
    shared = SharedCompactEncoder(segmenting.url, None, PATIENCE_S)
    segmenter, broken = shared.segmenter(), gives({"segmentation": segmentation})
    assert segmenter is not None

    def no_segmentations(handler: Handler, tensors: dict[str, Tensor]) -> None:
        (segmenting.right if "pictures" in tensors else broken)(handler, tensors)

    segmenting.answer = no_segmentations
    with pytest.raises(error, match=why):
        segmenter.segment(Image.of(drawn(640, 480)))
    shared.close()
