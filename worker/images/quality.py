"""What may keep a photo from being recognised: darkness, glare, a covered lens, blur."""

import cv2
import numpy as np
import numpy.typing as npt

from schemas.image import Image

LONGEST = 320
"""Photos are judged at this length of their longer side, so that the measures do not depend on the camera."""

DARK, BRIGHT = 24.0, 240.0
"""Mean luminance below which a photo counts as dark, and above which as overexposed, 0..255."""

FLAT = 5.0
"""Standard deviation of luminance below which a photo shows hardly anything."""

COARSE, BLANK = 32, 1.5
"""Squares along the longer side, and the standard deviation of their mean luminance below which a flat photo shows
nothing: noise averages out there, and what little an underexposed photo has does not."""

SEEN = 6.0
"""The same of some of its pixels alone, from which on it shows something: noise that is not averaged stays below."""

BLURRED = 20.0
"""Variance of the Laplacian below which a photo counts as blurred; sharp ones of places have hundreds (Pech-Pacheco et
al. 2000)."""


def problem(pixels: npt.NDArray[np.uint8]) -> str | None:
    """What is wrong with a photo, in words; None when nothing is.

    Parameters
    ----------
    pixels : uint8 of shape (height, width, 3)
        RGB.
    """
    luminance = cv2.cvtColor(_resized(pixels, LONGEST), cv2.COLOR_RGB2GRAY)
    mean, spread = float(luminance.mean()), float(luminance.std())
    if mean < DARK:
        return f"the image is dark (mean luminance {mean:.0f} of 255)"
    if mean > BRIGHT:
        return f"the image is overexposed (mean luminance {mean:.0f} of 255)"
    if spread < FLAT:
        return f"the image shows hardly anything (luminance varies by {spread:.1f} of 255): the lens may be covered"
    sharpness = float(cv2.Laplacian(luminance, cv2.CV_64F).var())
    if sharpness < BLURRED:
        return f"the image is blurred (sharpness {sharpness:.0f}; photos of places have hundreds)"
    return None


def is_blank(image: Image) -> bool:
    """Whether a photo shows nothing at all, noise apart: darkness, glare, a covered lens."""
    step = max(1, max(image.pixels.shape[:2]) // LONGEST)
    some = np.ascontiguousarray(image.pixels[::step, ::step, 1])
    if float(_resized(some, COARSE).std()) > SEEN:  # most photos, at a fiftieth of what the rest takes of a large one
        return False
    luminance = cv2.cvtColor(_resized(image.pixels, LONGEST), cv2.COLOR_RGB2GRAY)
    return float(luminance.std()) < FLAT and float(_resized(luminance, COARSE).std()) < BLANK


def _resized(pixels: npt.NDArray[np.uint8], longest: int) -> npt.NDArray[np.uint8]:
    factor = longest / max(pixels.shape[:2])
    size = (max(1, round(pixels.shape[1] * factor)), max(1, round(pixels.shape[0] * factor)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def problem_of(image: Image) -> str | None:
    """What is wrong with a decoded photo, in words; None when nothing is."""
    return problem(image.pixels)
