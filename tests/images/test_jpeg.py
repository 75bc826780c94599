"""Of a JPEG all that its decoder warns of is damage; what cameras do is not."""

import io
from typing import Any

import numpy as np
import pytest

from schemas.errors import BadImage
from tests.images.test_codec import LIMITS, mode, refusal
from tests.sample_images import drawn, encoded
from worker.images.codec import decode, thumbnail
from worker.images.jpeg import START_OF_SCAN, Structure


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"optimize": True, "quality": 30}])
def test_a_jpeg_truncated_anywhere_is_refused_even_with_a_whole_thumbnail_inside(options: dict[str, Any]) -> None:
    inner = encoded(drawn(160, 120), "jpeg")
    data = encoded(drawn(320, 240), "jpeg", exif=b"Exif\x00\x00" + inner[:60_000], **options)
    assert decode(data, LIMITS).width == 320
    for cut in [*range(4, len(data) - 4, len(data) // 60), len(data) - 4]:
        assert refusal(data[:cut]).code == "undecodable-picture", cut


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"restart_marker_rows": 1}])
@pytest.mark.parametrize("missing", [1, 2])
def test_a_jpeg_without_its_end_marker_is_taken_as_cameras_send_it(options: dict[str, Any], missing: int) -> None:
    data = encoded(drawn(320, 240), "jpeg", **options)
    image = decode(data[:-missing], LIMITS)
    assert np.array_equal(image.pixels, decode(data, LIMITS).pixels)
    assert thumbnail(data[:-missing], 40)


def test_a_progressive_jpeg_cut_between_two_scans_is_refused() -> None:
    data = encoded(drawn(320, 240), "jpeg", progressive=True)
    structure = Structure.read(data)
    assert structure is not None
    scans = [segment for segment in structure.segments if segment.marker == START_OF_SCAN]
    assert len(scans) > 5
    for scan in scans[:-1]:
        assert refusal(data[: scan.end]).code == "undecodable-picture"


@pytest.mark.parametrize("padding", [b"\x00", b"\x00" * 40, b"\x00" * 5000])
@pytest.mark.parametrize("end", [b"\xff\xd9", b""])
def test_zeros_with_which_a_camera_pads_its_scan_are_no_damage(padding: bytes, end: bytes) -> None:
    data = encoded(drawn(160, 120), "jpeg")
    assert np.array_equal(decode(data[:-2] + padding + end, LIMITS).pixels, decode(data, LIMITS).pixels)


def test_what_a_damaged_scan_leaves_over_is_refused() -> None:
    data = encoded(drawn(160, 120), "jpeg")
    assert "extraneous" in refusal(data[:-2] + bytes(range(1, 60)) + data[-2:]).detail


def test_flipped_bits_that_a_jpeg_decoder_warns_of_are_refused() -> None:
    """Most flips give another valid image; none of those that libjpeg warns of may pass."""
    chance = np.random.default_rng(5)
    noise = chance.integers(-30, 30, (120, 160, 3))
    data = encoded(np.clip(drawn(160, 120) + noise, 0, 255).astype(np.uint8), "jpeg", progressive=True)
    scan = data.index(b"\xff\xda") + 14
    refused = 0
    for at in chance.integers(scan, len(data) - 2, 100):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(chance.integers(8))
        try:
            decode(bytes(damaged), LIMITS)
        except BadImage as error:
            assert error.code == "undecodable-picture"
            refused += 1
    assert refused >= 15


def test_a_cmyk_jpeg_is_looked_over_as_well() -> None:
    out = io.BytesIO()
    mode("CMYK", drawn(160, 120)).save(out, "JPEG", quality=95)
    data = out.getvalue()
    assert decode(data[:-2], LIMITS).width == 160
    assert refusal(data[: len(data) // 2] + b"\xff\xd9").code == "undecodable-picture"


def test_a_jpeg_of_odd_sampling_factors_is_not_called_damaged() -> None:
    data = bytearray(encoded(drawn(160, 120), "jpeg"))
    data[data.index(b"\xff\xc0") + 11] = 0x42  # of the light, four by two of those of a colour
    assert "of a variant that is not read" in refusal(bytes(data)).detail


def test_a_jpeg_of_very_many_scans_is_refused_before_they_are_decoded() -> None:
    data = encoded(drawn(320, 240), "jpeg", progressive=True)
    structure = Structure.read(data)
    assert structure is not None
    last = structure.segments[-1]
    bomb = data[: last.end] + data[last.start : last.end] * 200 + b"\xff\xd9"
    assert "scans; at most" in refusal(bomb).detail


def test_a_jpeg_with_a_second_image_or_rubbish_behind_it_is_taken() -> None:
    data = encoded(drawn(80, 60), "jpeg")
    for tail in (b"\x00" * 100, b"SEFH and more from the camera", encoded(drawn(40, 40), "jpeg")):
        assert decode(data + tail, LIMITS).width == 80


def test_a_jpeg_that_turns_grey_midway_is_refused() -> None:
    data = bytearray(encoded(drawn(160, 120), "jpeg"))
    scan = data.index(b"\xff\xda")
    data[scan + 2000 : scan + 2002] = b"\xff\xd3"  # a restart that no table announced
    damaged = bytes(data[: scan + 4000]) + b"\xff\xc4\x00\x04\xff\xff" + bytes(data[scan + 4000 :])
    assert refusal(damaged).code == "undecodable-picture"


def test_a_jpeg_that_ends_in_grey_is_an_image() -> None:
    pixels = drawn(96, 64).copy()
    pixels[32:] = 128
    assert (decode(encoded(pixels, "jpeg"), LIMITS).pixels[-8:] == 128).all()
