"""Photometric augmentation: the same scene at another hour, in other weather, by another camera.

Images are RGB, uint8 of shape (height, width, 3). Everything random is drawn from the generator that is passed in.
"""

import cv2
import numpy as np

from schemas.description import Floats
from training.data.images import Pixels

_LUMA = np.array([0.299, 0.587, 0.114], np.float32)


def mild(image: Pixels, rng: np.random.Generator) -> Pixels:
    """Change exposure, contrast and noise a little and keep the colours; for the detail channel."""
    x = _unit_range(image) ** _factor(rng, 0.45)
    x = x * (1 + rng.uniform(-0.1, 0.1, 3).astype(np.float32))
    x = _saturated(x, 0.0 if rng.random() < 0.1 else rng.uniform(0.6, 1.3))
    x = (x - 0.5) * _factor(rng, 0.3) + 0.5 + np.float32(rng.uniform(-0.1, 0.1))
    if rng.random() < 0.5:
        x = x + _noise(rng, x.shape) * np.float32(rng.uniform(0, 0.04))
    return _camera(_bytes(x), rng, softness=1.2, worst_quality=25)


def strong(image: Pixels, rng: np.random.Generator, *, night: float = 0.35) -> Pixels:
    """Change light, colours and weather; for the semantic channel.

    Parameters
    ----------
    image : uint8 of shape (height, width, 3)
    rng : numpy.random.Generator
    night : float
        Probability that the result looks as at night, 0..1.
    """
    x = _unit_range(image)
    if rng.random() < 0.8:
        x = x ** _factor(rng, 0.7)
    if rng.random() < 0.5:
        x = x * (1 + rng.uniform(-0.25, 0.25, 3).astype(np.float32))
    draw = rng.random()
    if draw < 0.6:
        x = _saturated(x, 0.0 if draw < 0.25 else rng.uniform(0.2, 1.6))
    lit = _at_night(x, rng) if rng.random() < night else _by_day(x, rng)
    return _camera(lit, rng, softness=1.6, worst_quality=12)


def _by_day(x: Floats, rng: np.random.Generator) -> Pixels:
    if rng.random() < 0.35:
        x = _repainted(x, rng)
    if rng.random() < 0.3:
        x = x * _field(rng, x.shape, spread=rng.uniform(0.2, 0.4))
    if rng.random() < 0.5:
        x = (x - 0.5) * _factor(rng, 0.5) + 0.5 + np.float32(rng.uniform(-0.15, 0.15))
    if rng.random() < 0.15:  # fog: contrast sinks towards a bright grey
        x = x + (np.float32(rng.uniform(0.6, 0.95)) - x) * np.float32(rng.uniform(0.2, 0.7))
    if rng.random() < 0.3:
        channels = 1 if rng.random() < 0.5 else 3
        x = x + _noise(rng, (*x.shape[:2], channels)) * np.float32(rng.uniform(0, 0.12))
    image = _bytes(x)
    return _equalized(image, rng, color=True) if rng.random() < 0.1 else image


def _repainted(x: Floats, rng: np.random.Generator) -> Floats:
    """Give all surfaces of about the colour of a randomly drawn pixel another colour, as snow, leaves or rain do."""
    height, width = x.shape[:2]
    before = x[rng.integers(height // 3, height), rng.integers(width)]
    squares = ((x - before) ** 2).sum(axis=2, keepdims=True)
    similarity = np.exp(-squares / np.float32(2 * rng.uniform(0.08, 0.3) ** 2))
    if rng.random() < 0.5:
        color = np.float32(rng.uniform(0.75, 1.0)) * np.array([0.97, 0.98, 1.0], np.float32)
    else:
        color = np.float32(rng.uniform(0.15, 0.7)) * rng.uniform(0.6, 1.4, 3).astype(np.float32)
    texture = (x - before) * np.float32(rng.uniform(0.2, 1.0))
    return np.asarray(x + similarity * np.float32(rng.uniform(0.4, 1.0)) * (color + texture - x), np.float32)


def _at_night(x: Floats, rng: np.random.Generator) -> Pixels:
    height, width = x.shape[:2]
    grey = x @ _LUMA
    x = x * _field(rng, x.shape, spread=rng.uniform(0.2, 1.0))
    if rng.random() < 0.5:
        x = x + _lamps(rng, height, width)
    if rng.random() < 0.5:  # the sky, bright by day, goes dark
        bright = cv2.GaussianBlur(np.clip(grey * 3 - 1.8, 0, 1), (0, 0), 3)
        x = x * (1 - bright[..., None] * np.float32(rng.uniform(0.3, 0.95)))
    x = np.clip(x * np.float32(np.exp(rng.uniform(-2.2, -0.3))), 0, None)
    shot, readout = rng.uniform(0, 0.06), rng.uniform(0, 0.03)
    noise = _noise(rng, (height, width))
    if rng.random() < 0.5:
        noise = cv2.GaussianBlur(noise, (0, 0), 0.8) * 2
    noise = noise[..., None]
    if rng.random() < 0.5:
        noise = noise * np.float32(0.5) + _noise(rng, x.shape)
    x = x + noise * (np.sqrt(x) * np.float32(shot) + np.float32(readout))
    draw = rng.random()
    if draw < 0.4:  # a camera that stretches a low contrast
        low, high = np.percentile(x[::4, ::4], [1, rng.uniform(90, 99.5)])
        x = (x - np.float32(low)) / np.float32(max(high - low, 1e-3))
    image = _bytes(x)
    return _equalized(image, rng, color=False) if draw < 0.25 else image


def _camera(image: Pixels, rng: np.random.Generator, *, softness: float, worst_quality: int) -> Pixels:
    """Blur, reduce the resolution and compress as JPEG, each some of the time."""
    height, width = image.shape[:2]
    if rng.random() < 0.28:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, softness))
    if rng.random() < 0.2:  # a small image, enlarged
        shrink = rng.uniform(1.3, 4.0)
        small = cv2.resize(image, (int(width / shrink), int(height / shrink)), interpolation=cv2.INTER_AREA)
        image = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.33:
        quality = int(rng.integers(worst_quality, 85))
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        image = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
    return image


def _equalized(image: Pixels, rng: np.random.Generator, *, color: bool) -> Pixels:
    if color:
        lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
        lab[..., 0] = cv2.createCLAHE(rng.uniform(1, 6), (8, 8)).apply(lab[..., 0])
        return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), np.uint8)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    adaptive = cv2.createCLAHE(rng.uniform(2, 8), (8, 8))
    grey = cv2.equalizeHist(grey) if rng.random() < 0.6 else adaptive.apply(grey)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)


def _lamps(rng: np.random.Generator, height: int, width: int) -> Floats:
    light = np.zeros((height, width), np.float32)
    rows, columns = np.ogrid[:height, :width]
    for _ in range(rng.integers(1, 4)):
        x, y, radius = rng.uniform(0, width), rng.uniform(0, height * 0.7), rng.uniform(0.03, 0.25) * width
        distance = (columns - x) ** 2 + (rows - y) ** 2
        light += (np.exp(-distance / (2 * radius**2)) * rng.uniform(0.3, 1.5)).astype(np.float32)
    return light[..., None]


def _field(rng: np.random.Generator, shape: tuple[int, ...], *, spread: float) -> Floats:
    """Draw a smooth field of illumination around 1: float32 of shape (height, width, 1)."""
    coarse = _noise(rng, (int(rng.integers(2, 6)), int(rng.integers(2, 6))))
    smooth = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.exp(smooth * spread)[..., None], np.float32)


def _saturated(x: Floats, amount: float) -> Floats:
    grey = (x @ _LUMA)[..., None]
    return np.asarray(grey + (x - grey) * np.float32(amount), np.float32)


def _factor(rng: np.random.Generator, spread: float) -> np.float32:
    return np.float32(np.exp(rng.uniform(-spread, spread)))


def _noise(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    return rng.standard_normal(shape, dtype=np.float32)


def _unit_range(image: Pixels) -> Floats:
    return image.astype(np.float32) / np.float32(255)


def _bytes(x: Floats) -> Pixels:
    return (np.clip(x, 0, 1) * 255).astype(np.uint8)
