"""What is wrong with a photo is said in words."""

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from scenes import scene
from scenes.carried import bonnet
from scenes.scene import Lighting
from schemas.image import Image
from worker.images.quality import is_blank, problem

Change = Callable[[np.ndarray], np.ndarray]


@cache
def photo(light: Lighting = "noon") -> np.ndarray:
    """Drawn when a test asks for it: what collects the tests does not wait."""
    return scene("mill lane").at(light).pixels


def smaller(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.resize(pixels, (64, 48), interpolation=cv2.INTER_AREA))


@pytest.mark.parametrize("light", ["noon", "dusk", "night"])
def test_nothing_is_wrong_with_a_photo_of_a_place(light: Lighting) -> None:
    assert problem(photo(light)) is None


def test_nothing_is_wrong_with_a_small_photo() -> None:
    assert problem(smaller(photo())) is None


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (lambda pixels: (pixels * 0.08).astype(np.uint8), "dark"),
        (lambda pixels: np.maximum(pixels, 250), "overexposed"),
        (lambda pixels: np.full_like(pixels, 128), "hardly anything"),
        (lambda pixels: cv2.GaussianBlur(pixels, (0, 0), 12), "blurred"),
    ],
)
def test_what_keeps_a_photo_from_being_recognised(spoilt: Change, said: str) -> None:
    assert said in str(problem(spoilt(photo())))


def grainy(level: float) -> np.ndarray:
    """What a covered lens gives: noise of the sensor."""
    grain = np.random.default_rng(1).normal(level, 4, (480, 640, 3))
    return np.clip(grain, 0, 255).astype(np.uint8)


def even(value: int) -> np.ndarray:
    return np.full((480, 640, 3), value, np.uint8)


@pytest.mark.parametrize("pixels", [grainy(8), grainy(0), grainy(128), even(252), even(0)])
def test_darkness_glare_and_a_covered_lens_show_nothing(pixels: np.ndarray) -> None:
    assert is_blank(Image(pixels, "", "jpeg", 1))


def letterboxed(pixels: np.ndarray) -> np.ndarray:
    return np.pad(pixels, ((100, 100), (0, 0), (0, 0)))


def upright(pixels: np.ndarray) -> np.ndarray:
    return np.pad(pixels, ((0, 0), (240, 240), (0, 0)))


def fisheye(pixels: np.ndarray) -> np.ndarray:
    """The circle that such a lens shows."""
    height, width = pixels.shape[:2]
    circle = cv2.circle(np.zeros((height, width, 1), np.uint8), (width // 2, height // 2), height // 2, 1, -1)
    return np.asarray(pixels * circle)


BORDERED = [letterboxed, upright, fisheye]


@pytest.mark.parametrize("bordered", BORDERED)
@pytest.mark.parametrize("pixels", [grainy(8), grainy(128), even(252)])
def test_nothing_within_a_black_border_is_nothing(pixels: np.ndarray, bordered: Change) -> None:
    said = [str(problem(one)).partition(" (")[0] for one in (bordered(pixels), pixels)]
    assert said[0] == said[1]
    assert is_blank(Image(bordered(pixels), "", "jpeg", 1))


@pytest.mark.parametrize("bordered", BORDERED)
@pytest.mark.parametrize("light", ["noon", "dusk", "night"])
def test_something_within_a_black_border_is_something(light: Lighting, bordered: Change) -> None:
    assert problem(bordered(photo(light))) is None
    assert not is_blank(Image(bordered(photo(light)), "", "jpeg", 1))


def test_what_is_fixed_to_the_camera_does_not_count() -> None:
    fixed = np.zeros((16, 28), np.bool_)
    fixed[12:] = True
    assert is_blank(Image(bonnet(grainy(128), 0.25), "", "jpeg", 1), fixed)
    assert not is_blank(Image(bonnet(grainy(128), 0.25), "", "jpeg", 1))
    assert not is_blank(Image(bonnet(photo(), 0.25), "", "jpeg", 1), fixed)


@pytest.mark.parametrize(
    ("light", "faded"),
    [
        ("noon", lambda pixels: pixels),
        ("night", lambda pixels: pixels),
        ("noon", lambda pixels: pixels // 12),
        ("night", lambda pixels: pixels // 4),
        ("noon", lambda pixels: 200 + pixels // 12),
    ],
)
def test_what_little_an_underexposed_or_foggy_photo_shows_is_something(light: Lighting, faded: Change) -> None:
    assert not is_blank(Image(faded(photo(light)), "", "jpeg", 1))
