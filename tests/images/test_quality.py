"""What is wrong with a photo is said in words."""

import cv2
import numpy as np
import pytest

from scenes import scene
from worker.images.quality import problem

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
