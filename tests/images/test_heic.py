"""HEIC as phones save it: upright, whole or refused, given back as JPEG."""

import io
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image as PilImage

from lab.faults.heics import heics
from schemas.errors import BadImage
from tests.sample_images import drawn
from worker.images.apart.pool import DecoderPool
from worker.images.codec import Limits, decode, probe, thumbnail
from worker.images.exif import read_exif
from worker.images.heic import SMALLEST, is_heic

LIMITS = Limits()
HEICS = heics()


def difference(one: np.ndarray, two: np.ndarray) -> float:
    return float(np.abs(one.astype(int) - two).mean())


def test_the_pixels_are_those_of_the_photo() -> None:
    found = decode(HEICS["plain"], LIMITS)

    assert (found.format, found.width, found.height) == ("heic", 96, 64)
    assert difference(found.pixels, drawn(96, 64)) < 4


def test_a_turned_photo_is_upright() -> None:
    facts, found = probe(HEICS["turned"], LIMITS), decode(HEICS["turned"], LIMITS)

    assert (facts.width, facts.height) == (found.width, found.height) == (64, 96)
    assert difference(found.pixels, np.rot90(drawn(96, 64), -1)) < 4
    with PilImage.open(io.BytesIO(thumbnail(HEICS["turned"], 48))) as small:
        assert (small.size, dict(small.getexif())) == ((32, 48), {})


def test_grey_and_alpha_are_taken_too() -> None:
    grey = decode(HEICS["grey"], LIMITS).pixels

    assert np.array_equal(grey[..., 0], grey[..., 1])
    assert difference(decode(HEICS["alpha"], LIMITS).pixels, drawn(96, 64)) < 4


def test_apart_it_is_the_same() -> None:
    pool = DecoderPool(1, LIMITS, deadline_s=20)
    pool.start()
    try:
        for data in HEICS.values():
            assert np.array_equal(pool.decode(data).pixels, decode(data, LIMITS).pixels)
            assert pool.thumbnail(data, 32) == thumbnail(data, 32)
    finally:
        pool.close()


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.8, 0.98])
def test_a_file_that_ends_too_early_is_refused(cut: float) -> None:
    data = HEICS["plain"]
    with pytest.raises(BadImage, match="heic"):
        decode(data[: int(len(data) * cut)], LIMITS)


@given(st.integers(12, len(HEICS["plain"]) - 1), st.integers(1, 255))
def test_a_flipped_byte_gives_an_image_or_a_refusal(at: int, flip: int) -> None:
    data = bytearray(HEICS["plain"])
    data[at] ^= flip
    with suppress(BadImage):
        decode(bytes(data), LIMITS)


def test_too_large_and_too_small_are_told_from_the_header() -> None:
    with pytest.raises(BadImage) as large:
        decode(HEICS["plain"], Limits(max_pixels=6000))
    assert large.value.code == "picture-too-large"
    assert decode(SMALLEST, LIMITS).width == 32


def brands(major: bytes, *others: bytes) -> bytes:
    box = b"ftyp" + major + bytes(4) + b"".join(others)
    return (len(box) + 4).to_bytes(4, "big") + box + bytes(300)


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        (brands(b"heic", b"mif1"), True),
        (brands(b"mif1", b"mif1", b"heic"), True),
        (brands(b"mif1", b"avif"), False),
        (brands(b"avif", b"mif1", b"heic"), False),
        (brands(b"isom"), False),
        (b"", False),
    ],
)
def test_the_type_is_known_by_its_brands(head: bytes, expected: bool) -> None:
    assert is_heic(head) is expected


def test_where_and_when_it_was_taken_is_read_from_it(tmp_path: Path) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes(HEICS["turned"])

    known = read_exif(tmp_path / "IMG_1.HEIC")

    assert known["lat"] == pytest.approx(50 + 5 / 60)
    assert known["heading"] == 90
    assert known["captured_at"].isoformat() == "2026-05-04T09:30:00+00:00"
