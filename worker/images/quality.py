"""What may keep a photo from being recognised: darkness, glare, a covered lens, blur."""

import cv2
import numpy as np
import numpy.typing as npt

from schemas.description import Booleans
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

BORDER, EVEN = 20.0, 2.0
"""Mean luminance up to which squares in all four corners may be of a black border, as of a fisheye, a letterbox or an
upright video, and by how much darker or brighter its other squares are at most."""

ASKEW, MOST_BORDER = 0.05, 0.8
"""Share of the squares in which a border may differ from its mirror images, and that it may cover."""

LEAST_SEEN = 0.1
"""Share of the squares that must be left for a photo to be judged without the others."""

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
    seen = _enlarged(_seen(luminance), luminance)
    mean, spread = float(luminance[seen].mean()), float(luminance[seen].std())
    if mean < DARK:
        return f"the image is dark (mean luminance {mean:.0f} of 255)"
    if mean > BRIGHT:
        return f"the image is overexposed (mean luminance {mean:.0f} of 255)"
    if spread < FLAT:
        return f"the image shows hardly anything (luminance varies by {spread:.1f} of 255): the lens may be covered"
    sharpness = float(cv2.Laplacian(luminance, cv2.CV_64F)[seen].var())
    if sharpness < BLURRED:
        return f"the image is blurred (sharpness {sharpness:.0f}; photos of places have hundreds)"
    return None


def is_blank(image: Image, fixed: Booleans | None = None) -> bool:
    """Whether a photo shows nothing at all, noise apart: darkness, glare, a covered lens.

    Parameters
    ----------
    image : Image
    fixed : bool of shape (rows, columns), optional
        Cells of it that show what is fixed to the camera, which does not count; nor does a black border.
    """
    step = max(1, max(image.pixels.shape[:2]) // LONGEST)
    some = np.ascontiguousarray(image.pixels[::step, ::step, 1])
    # Most photos show something here, at a fiftieth of what the rest takes of a large one.
    if float(_resized(some, COARSE)[_seen(some, fixed)].std()) > SEEN:
        return False
    luminance = cv2.cvtColor(_resized(image.pixels, LONGEST), cv2.COLOR_RGB2GRAY)
    seen = _seen(luminance, fixed)
    spread = float(luminance[_enlarged(seen, luminance)].std())
    return spread < FLAT and float(_resized(luminance, COARSE)[seen].std()) < BLANK


def _seen(luminance: npt.NDArray[np.uint8], fixed: Booleans | None = None) -> Booleans:
    """Which of `COARSE` squares show nothing of a black border and of what is fixed to the camera; all of them where
    hardly any would be left."""
    hidden = _border(luminance)
    if fixed is not None and fixed.size:
        hidden = hidden | _enlarged(_widened(fixed), hidden)
    if not hidden.any():
        return ~hidden
    seen = ~_widened(hidden)
    return seen if seen.mean() >= LEAST_SEEN else np.ones_like(seen)


def _widened(squares: Booleans) -> Booleans:
    """With those beside them, which may show some of the same."""
    return np.asarray(cv2.dilate(squares.astype(np.uint8), np.ones((3, 3), np.uint8)) == 1)


def _border(luminance: npt.NDArray[np.uint8]) -> Booleans:
    """Which of `COARSE` squares show some of a black border: it is in all four corners, and the same on both sides,
    above and below."""
    coarse = _resized(luminance, COARSE)
    corner = int(coarse[[0, 0, -1, -1], [0, -1, 0, -1]].max())
    border = coarse <= corner + EVEN
    askew = max(float((border != border[::-1]).mean()), float((border != border[:, ::-1]).mean()))
    if corner > BORDER or askew > ASKEW or border.mean() > MOST_BORDER:
        return np.zeros_like(border)
    black = cv2.medianBlur(luminance, 5) <= corner + EVEN  # noise apart
    return np.asarray(_resized(np.where(black, np.uint8(255), np.uint8(0)), COARSE) > 0)


def _enlarged(squares: Booleans, to: npt.NDArray[np.generic]) -> Booleans:
    """Squares on as many rows and columns as another array has."""
    size = to.shape[1], to.shape[0]
    return np.asarray(cv2.resize(squares.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 1)


def _resized(pixels: npt.NDArray[np.uint8], longest: int) -> npt.NDArray[np.uint8]:
    factor = longest / max(pixels.shape[:2])
    size = (max(1, round(pixels.shape[1] * factor)), max(1, round(pixels.shape[0] * factor)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def problem_of(image: Image) -> str | None:
    """What is wrong with a decoded photo, in words; None when nothing is."""
    return problem(image.pixels)
