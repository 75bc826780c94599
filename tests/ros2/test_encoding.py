"""Images as ROS carries them become files that the service's own decoder reads to the same pixels."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from revisit_ros.encoding import CHANNELS, Unusable, as_file, checked

from tests.sample_images import drawn
from worker.images.codec import Limits, decode

LIMITS = Limits(max_bytes=5_000_000, max_pixels=1_000_000)


def test_two_pixels_by_hand() -> None:
    """Blue over red, as rgb8: a BMP begins at the bottom, says blue first, and fills rows to four bytes."""
    written = as_file("rgb8", 1, 2, 3, bytes([0, 0, 255, 255, 0, 0]))
    assert written[:2] == b"BM"
    assert struct.unpack("<I", written[2:6]) == (len(written),) == (54 + 8,)
    assert written[54:] == bytes([0, 0, 255, 0, 255, 0, 0, 0])


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("8UC3", [2, 1, 0]), ("rgba8", [0, 1, 2, 3]), ("bgra8", [2, 1, 0, 3])],
)
@settings(max_examples=10)
@given(width=st.integers(32, 39), height=st.integers(32, 35), gap=st.integers(0, 9))
def test_colours_and_rows_arrive_as_they_were(
    encoding: str, order: list[int], width: int, height: int, gap: int
) -> None:
    pixels = drawn(width, height)
    opaque = np.dstack([pixels, np.full((height, width), 77, np.uint8)])
    rows = np.ascontiguousarray(opaque[:, :, order]).reshape(height, -1)
    step = rows.shape[1] + gap
    sent = np.pad(rows, ((0, 0), (0, gap)), constant_values=255).tobytes()

    for data in (sent, sent[: len(sent) - gap]):  # some drivers leave the last row without its gap
        image = decode(as_file(encoding, width, height, step, data), LIMITS)
        assert (image.format, image.pixels.tolist()) == ("bmp", pixels.tolist())


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
@pytest.mark.parametrize("width", [32, 33, 34, 35])
def test_greys_stay_grey(encoding: str, width: int) -> None:
    grey = drawn(width, 32)[:, :, 0]
    image = decode(as_file(encoding, width, 32, width, grey.tobytes()), LIMITS)
    assert image.pixels.tolist() == np.dstack([grey] * 3).tolist()


@pytest.mark.parametrize(
    ("encoding", "told"),
    [
        ("mono16", "colour camera"),
        ("16UC1", "colour camera"),
        ("rgb16", "colour camera"),
        ("32FC1", "colour camera"),
        ("bayer_rggb8", "debayer"),
        ("yuv422", "republish"),
        ("", "republish"),
        ("RGB8", "republish"),
    ],
)
def test_other_encodings_are_refused_with_a_way_out(encoding: str, told: str) -> None:
    with pytest.raises(Unusable, match=told) as refused:
        as_file(encoding, 4, 4, 64, b"\0" * 256)
    assert repr(encoding) in str(refused.value)


@given(st.sampled_from(sorted(CHANNELS)), st.integers(0, 5), st.integers(0, 5), st.integers(0, 30), st.integers(0, 200))
def test_whatever_does_not_add_up_is_refused(encoding: str, width: int, height: int, step: int, length: int) -> None:
    used = width * CHANNELS[encoding][0]
    fits = width > 0 and height > 0 and step >= used and length >= step * (height - 1) + used
    if fits:
        assert as_file(encoding, width, height, step, b"\0" * length)[:2] == b"BM"
    else:
        with pytest.raises(Unusable, match="add up"):
            as_file(encoding, width, height, step, b"\0" * length)


@pytest.mark.parametrize("form", ["jpeg", "png", "rgb8; jpeg compressed bgr8", "bgr8; png compressed ", "", "webp"])
def test_compressed_images_are_passed_on_as_they_are(form: str) -> None:
    assert checked(form, b"whatever") == b"whatever"


@pytest.mark.parametrize("form", ["16UC1; compressedDepth", "32FC1; compressedDepth png", "mono16; png compressed "])
def test_compressed_depth_is_refused(form: str) -> None:
    with pytest.raises(Unusable, match="colour camera"):
        checked(form, b"whatever")


def test_a_compressed_image_without_bytes_is_refused() -> None:
    with pytest.raises(Unusable, match="no bytes"):
        checked("jpeg", b"")
