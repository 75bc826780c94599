"""An encoder that a test holds back, and images that are numbers."""

import threading
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.image import Image
from schemas.records import Meaning


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


def image(number: int) -> Image:
    return Image.of(np.full((32, 32, 3), number, np.uint8))


def number_of(shown: Image, _: PixelField) -> int:
    return int(shown.pixels[0, 0, 0])
