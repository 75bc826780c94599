"""What is wrong with a photo is said in words."""

import cv2
import numpy as np
import pytest

from scenes import scene
from schemas.image import Image
from worker.images.quality import is_blank, problem

PHOTO = scene("mill lane").pixels
DUSK, NIGHT = (scene("mill lane").at(light).pixels for light in ("dusk", "night"))


@pytest.mark.parametrize("pixels", [PHOTO, DUSK, NIGHT, cv2.resize(PHOTO, (64, 48), interpolation=cv2.INTER_AREA)])
def test_nothing_is_wrong_with_a_photo_of_a_place(pixels: np.ndarray) -> None:
    assert problem(pixels) is None


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        ((PHOTO * 0.08).astype(np.uint8), "dark"),
        (np.maximum(PHOTO, 250), "overexposed"),
        (np.full_like(PHOTO, 128), "hardly anything"),
        (cv2.GaussianBlur(PHOTO, (0, 0), 12), "blurred"),
    ],
)
def test_what_keeps_a_photo_from_being_recognised(pixels: np.ndarray, said: str) -> None:
    assert said in str(problem(pixels))


def grainy(level: float) -> np.ndarray:
    """What a covered lens gives: noise of the sensor."""
    grain = np.random.default_rng(1).normal(level, 4, (480, 640, 3))
    return np.clip(grain, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("pixels", [grainy(8), grainy(0), grainy(128), np.full_like(PHOTO, 252), PHOTO * 0])
def test_darkness_glare_and_a_covered_lens_show_nothing(pixels: np.ndarray) -> None:
    assert is_blank(Image(pixels, "", "jpeg", 1))


@pytest.mark.parametrize("pixels", [PHOTO, NIGHT, PHOTO // 12, NIGHT // 4, 200 + PHOTO // 12])
def test_what_little_an_underexposed_or_foggy_photo_shows_is_something(pixels: np.ndarray) -> None:
    assert not is_blank(Image(pixels, "", "jpeg", 1))
