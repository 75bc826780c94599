"""What is enrolled is decoded once, and described as if it had been read from the store."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PilImage

from schemas.description import Description
from schemas.image import Image
from schemas.records import Filters, ViewAttributes
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from worker.description.presets import Wanted
from worker.images import codec
from worker.images.decoder import InProcessDecoder
from worker.runtime import Runtime, build
from worker.service.decoded import DecodedImages


class CountingDecoder(InProcessDecoder):
    """Remembers the digests of what it decoded, in order."""

    def __init__(self) -> None:
        super().__init__(codec.Limits(1_000_000, 1_000_000))
        self.seen: list[str] = []

    def decode(self, data: bytes, *, patient: bool = False, stored: bool = False) -> Image:
        self.seen.append(digest(data))
        return super().decode(data, patient=patient, stored=stored)


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def pixel(value: int, wide: int = 4) -> Image:
    return Image.of(np.full((1, wide, 3), value, np.uint8))


def test_images_are_kept_while_there_is_room_and_handed_on_once() -> None:
    kept = DecodedImages(most_bytes=24)
    first, second, third = pixel(1), pixel(2), pixel(3)
    for image in (first, second, second, third):  # the third finds no room
        kept.keep(image)
    assert [kept.take(image.digest) for image in (third, first, first)] == [None, first, None]
    kept.keep(third)
    assert kept.take(third.digest) is third
    kept.clear()
    assert kept.take(second.digest) is None
    large = pixel(4, wide=8)
    kept.keep(large)  # all of the room was given back
    assert kept.take(large.digest) is large
    nothing = DecodedImages(0)
    nothing.keep(first)
    assert nothing.take(first.digest) is None


@pytest.fixture
def decoder() -> CountingDecoder:
    return CountingDecoder()


@pytest.fixture
def runtime(tmp_path: Path, decoder: CountingDecoder, monkeypatch: pytest.MonkeyPatch) -> Iterator[Runtime]:
    monkeypatch.setattr("worker.runtime.parts.make_decoder", lambda settings: decoder)
    runtime = build(settings(tmp_path, compare=False))
    runtime.start()
    yield runtime
    runtime.stop()


def described(runtime: Runtime, data: bytes, name: str) -> Description:
    done = runtime.services.enroll.enroll(data, name, ViewAttributes(), patience_s=60)
    description = runtime.store.descriptions.whole(done.view.seq, runtime.default_recipe.description)
    assert description is not None
    return description


@pytest.mark.parametrize("form", ["jpeg", "png"])
def test_a_photo_is_described_alike_whether_it_is_handed_on_or_read_from_the_store(
    runtime: Runtime, decoder: CountingDecoder, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    exif = PilImage.Exif()
    exif[0x0112] = 6  # the camera was turned by a quarter
    data = encoded(drawn(96, 64, 5), form, exif=exif)

    one = described(runtime, data, "handed on")
    assert decoder.seen == [digest(data)]
    monkeypatch.setattr(DecodedImages, "keep", lambda self, image: None)
    other = described(runtime, data, "from the store")
    assert decoder.seen == [digest(data)] * 3

    assert one.vectors.keys() == other.vectors.keys()
    for name, vector in one.vectors.items():
        assert np.array_equal(vector, other.vectors[name])
    assert np.array_equal(one.cells, other.cells)
    assert one.keypoints is not None
    assert other.keypoints is not None
    assert len(one.keypoints.positions) > 0
    assert np.array_equal(one.keypoints.positions, other.keypoints.positions)
    assert np.array_equal(one.keypoints.descriptors, other.keypoints.descriptors)


def test_a_blurred_image_is_described_as_it_is_stored(runtime: Runtime, decoder: CountingDecoder) -> None:
    runtime.services.maps.put("shop", Wanted())
    runtime.services.maps.change("shop", blur=["people"])
    sent = encoded(drawn(96, 64, 2))
    described(runtime, sent, "shop")
    stored = {view.image.sha256 for view in runtime.store.views.list("shop", Filters())[0]}
    assert digest(sent) not in stored
    assert decoder.seen[0] == digest(sent)
    assert decoder.seen[1] in stored
