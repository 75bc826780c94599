"""An image as another camera would have taken it: its size, its middle, and what lies around."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from scenes import scene
from schemas.image import Image
from schemas.values import LARGEST_ZOOM
from tests.stories.photos import middle
from worker.images.framing import LONGEST, framed


def image_of(height: int, width: int) -> Image:
    return Image.of(np.random.default_rng(height * width).integers(0, 256, (height, width, 3), np.uint8))


def test_an_image_of_the_maps_own_camera_stays_what_it_is() -> None:
    image = image_of(40, 60)
    assert framed(image, 1.0, 0.0) is image


@settings(max_examples=60, deadline=None)
@given(st.integers(32, 1500), st.integers(32, 1500), st.floats(1 / LARGEST_ZOOM, LARGEST_ZOOM))
def test_the_shape_stays_and_what_is_compared_is_not_large(height: int, width: int, zoom: float) -> None:
    image = image_of(height, width)
    seen = framed(image, zoom)

    assert (seen.format, seen.byte_count) == (image.format, image.byte_count)
    assert (seen.digest == image.digest) == (zoom == 1)
    if zoom == 1:
        return
    assert max(seen.pixels.shape) == pytest.approx(min(max(height, width) * zoom, LONGEST), abs=0.5)
    scale = min(1, LONGEST / (max(height, width) * zoom)) * zoom
    assert np.allclose(seen.pixels.shape[:2], np.multiply((height, width), scale), atol=1)


def test_a_wider_camera_is_left_with_its_middle() -> None:
    image = image_of(120, 160)
    assert np.array_equal(framed(image, 0.5).pixels, image.pixels[30:90, 40:120])


@pytest.mark.parametrize("zoom", [1.4, 2.0, LARGEST_ZOOM])
def test_a_narrower_camera_sees_its_image_in_the_middle_at_its_size(zoom: float) -> None:
    image = image_of(60, 90)
    seen = framed(image, zoom).pixels

    assert seen.shape[:2] == (round(60 * zoom), round(90 * zoom))
    assert np.array_equal(middle(seen, 1 / zoom), image.pixels)


@pytest.mark.parametrize("quarters", [-1, 1, 2])
def test_a_camera_that_was_turned_is_set_upright(quarters: int) -> None:
    upright = image_of(64, 96)
    # Turned clockwise, a camera sees things turned the other way, as `rot90` turns them.
    taken = Image.of(np.rot90(upright.pixels, quarters))
    assert np.array_equal(framed(taken, roll=90.0 * quarters).pixels, upright.pixels)


@settings(max_examples=20, deadline=None)
@given(st.floats(-45, 45))
def test_what_leans_comes_back_upright(roll: float) -> None:
    pixels = scene("market street").sized(320, 240).pixels
    back = framed(framed(Image.of(pixels), roll=-roll), roll=roll).pixels

    assert back.shape == pixels.shape
    before, after = (middle(each, 0.5).astype(int) for each in (pixels, back))
    assert np.abs(before - after).mean() < 6


def test_a_large_photo_is_shrunk() -> None:
    pixels = scene("market street").sized(1600, 1200).pixels
    wide = Image.of(np.repeat(np.repeat(pixels, 2, axis=0), 2, axis=1))
    surrounded, cropped = framed(wide, 2.0).pixels, framed(wide, 0.8).pixels

    assert surrounded.shape == cropped.shape == (960, 1280, 3)
    shrunk = cv2.resize(pixels, (640, 480), interpolation=cv2.INTER_AREA)
    assert np.abs(middle(surrounded, 0.5).astype(int) - shrunk).max() <= 1
    half = middle(pixels, 0.8)
    assert np.abs(cropped.astype(int) - half).max() <= 1
