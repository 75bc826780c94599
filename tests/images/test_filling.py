"""Covered parts of an image: nothing of them is left, and the rest is as it was."""

import io
import time

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image as PilImage

from schemas.description import Booleans
from schemas.image import Bytes2D
from worker.images.filling import NOTHING_LEFT, encoded, filled, mask_of


def noise(seed: int, height: int, width: int) -> Bytes2D:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def mask(height: int, width: int, *boxes: tuple[int, int, int, int]) -> Booleans:
    found = np.zeros((height, width), np.bool_)
    for top, left, bottom, right in boxes:
        found[top:bottom, left:right] = True
    return found


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 999),
    st.integers(0, 999),
    st.integers(1, 700),
    st.integers(1, 700),
    st.tuples(st.floats(0, 1), st.floats(0, 1), st.floats(0, 1), st.floats(0, 1)),
)
def test_the_result_is_the_same_whatever_was_covered(
    one: int, other: int, height: int, width: int, box: tuple[float, float, float, float]
) -> None:
    top, bottom = sorted((round(box[0] * height), round(box[1] * height)))
    left, right = sorted((round(box[2] * width), round(box[3] * width)))
    covered = mask(height, width, (top, left, bottom, right))
    pixels = noise(one, height, width)
    changed = np.where(covered[..., None], noise(other, height, width), pixels)

    result = filled(pixels, covered)

    assert np.array_equal(result, filled(changed, covered))
    assert np.array_equal(result[~covered], pixels[~covered])


def test_the_fill_blends_what_is_around_it() -> None:
    pixels = np.zeros((90, 120, 3), np.uint8)
    pixels[:, :60], pixels[:, 60:] = (200, 40, 40), (40, 40, 200)
    covered = mask(90, 120, (30, 30, 60, 90))
    pixels[covered] = (0, 255, 0)
    result = filled(pixels, covered)
    red, blue = result[45, 34].astype(int), result[45, 86].astype(int)
    assert red[0] > red[2] + 40
    assert blue[2] > blue[0] + 40
    assert result[covered][:, 1].max() <= 60, "no green is left"
    assert np.abs(np.diff(result[45, 31:89].astype(int), axis=0)).max() <= 24, "smooth"


def test_an_image_that_is_covered_entirely_is_grey() -> None:
    assert (filled(noise(1, 40, 50), mask(40, 50, (0, 0, 40, 50))) == NOTHING_LEFT).all()
    untouched = noise(1, 40, 50)
    assert np.array_equal(filled(untouched, mask(40, 50)), untouched)


def test_a_cell_covers_its_pixels_and_a_margin() -> None:
    cells = np.zeros((6, 8), np.bool_)
    cells[2, 3] = True
    covered = mask_of(cells, 480, 360, margin=0.01)
    assert covered[115:185, 175:245].all(), "60 x 60 pixels and 5 more on each side"
    assert not covered[:60].any()
    assert not covered[:, 360:].any()
    assert mask_of(np.ones((6, 8), np.bool_), 33, 35).all()
    assert not mask_of(np.zeros((6, 8), np.bool_), 33, 35).any()


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 999),
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.tuples(st.integers(1, 700), st.integers(1, 700)),
    st.sampled_from([0.0, 0.012, 0.1, 0.6]),
    st.floats(0, 0.2),
)
def test_the_margin_is_that_of_a_dilation(
    seed: int, grid: tuple[int, int], size: tuple[int, int], margin: float, share: float
) -> None:
    cells = np.random.default_rng(seed).random(grid) < share
    width, height = size
    plain = cv2.resize(cells.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.25
    reach = max(1, round(margin * max(size)))
    dilated = cv2.dilate(plain.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))

    assert np.array_equal(mask_of(cells, width, height, margin), dilated > 0)


def test_a_wide_margin_takes_no_longer_than_a_narrow_one() -> None:
    cells = np.zeros((2, 120), np.bool_)
    cells[0, 60] = True

    def seconds(margin: float) -> float:
        begin = time.process_time()  # of the processor: a busy machine is slow, not wrong
        mask_of(cells, 40_000, 600, margin)
        return time.process_time() - begin

    seconds(0.012)
    narrow = min(seconds(1e-6) for _ in range(3))
    assert min(seconds(0.02) for _ in range(3)) < 4 * narrow + 0.2  # a dilation took a hundred times as long


def test_what_is_stored_has_no_metadata_and_fits_where_it_can() -> None:
    pixels = noise(2, 600, 800)
    best, form = encoded(pixels, 10_000_000)
    assert form == "jpeg"
    smaller, _ = encoded(pixels, len(best) - 1)
    assert len(smaller) < len(best)
    assert encoded(pixels, 10)[0], "the least there is"
    with PilImage.open(io.BytesIO(best)) as image:
        assert (image.format, image.size) == ("JPEG", (800, 600))
        assert not image.getexif()


def test_a_side_that_is_too_long_for_jpeg_is_stored_as_png() -> None:
    data, form = encoded(np.zeros((32, 65_600, 3), np.uint8), 10_000_000)
    assert (form, data[:4]) == ("png", b"\x89PNG")


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (2, 3)])
def test_small_and_narrow_images(size: tuple[int, int]) -> None:
    covered = mask(*size, (0, 0, 1, 1))
    assert filled(noise(3, *size), covered).shape == (*size, 3)
