"""A shared encoder that a test holds back, and what is sent to it."""

import threading
from collections.abc import Iterator, Sequence

import httpx
import numpy as np
from fastapi.testclient import TestClient

from app.http.encoding import encoder_application
from schemas.description import PixelField
from schemas.image import Bytes2D, Image, PreparedImage
from schemas.inference import JSON_LENGTH, PIXELS, Tensor, packed
from schemas.settings import read_settings
from tests.waiting import PATIENCE_S
from worker.encoders.color import ColorEncoder
from worker.service.encoding import EncodingService


class GatedEncoder(ColorEncoder):
    """Encodes whenever the test lets it, and remembers what it was given together."""

    def __init__(self) -> None:
        super().__init__()
        self.batches: list[list[int]] = []
        self.open = threading.Event()
        self.open.set()

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        numbers = [int(image.pixels[0, 0, 0]) for image in images]
        self.batches.append(numbers)
        self.open.wait(PATIENCE_S)
        if 99 in numbers:
            raise RuntimeError("this picture kills the network")
        return super().encode(images)


class GatedSegmenter:
    """Draws the first pixel of each scale, whenever the test lets it."""

    digest, scales = "d" * 64, 2

    def __init__(self) -> None:
        self.open = threading.Event()
        self.open.set()
        self.urgent: list[bool] = []

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        assert isinstance(image, PreparedImage)
        self.urgent.append(urgent)
        self.open.wait(PATIENCE_S)
        drawn = np.array([scale[0, 0, 0] for scale in image.scales], np.float32)
        return PixelField({"semantic": np.broadcast_to(drawn, (*image.grid, 2)).copy()}, image.extent)


def serving(
    encoder: GatedEncoder, *, most: int = 8, segmenter: GatedSegmenter | None = None, **settings: str
) -> TestClient:
    app = encoder_application(
        lambda observe: EncodingService(encoder, 4, observe, most, segmenter),
        read_settings({f"REVISIT_{name.upper()}": value for name, value in settings.items()}),
    )
    return TestClient(app, raise_server_exceptions=False)


def pixels(*numbers: int, side: int = 32) -> Bytes2D:
    return np.stack([np.full((side, 64, 3), number, np.uint8) for number in numbers])


def ask(
    client: TestClient, images: Tensor, model: str | None = None, *, name: str = PIXELS, **further: object
) -> httpx.Response:
    length, body = packed("inputs", {name: images}, further)
    model = client.app.state.shared.service.model if model is None else model  # type: ignore[attr-defined]
    headers = {JSON_LENGTH: str(length), "content-type": "application/octet-stream"}
    answer: httpx.Response = client.post(f"/v2/models/{model}/infer", content=body, headers=headers)
    return answer
