"""Textures of materials: brick, plaster, asphalt, paving, grass, tiles, as RGB uint8."""

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from scenes.geometry import Pixels

Colour = tuple[int, int, int]
Field = npt.NDArray[np.float32]


def bands(rows: int) -> Iterator[slice]:
    """Slices of rows that are worked on one after the other, so that what comes between stays in the cache."""
    return (slice(first, min(first + 64, rows)) for first in range(0, rows, 64))


def noise(rng: np.random.Generator, size: tuple[int, int], cells: float, octaves: int = 4) -> Field:
    """Smooth noise of mean 0 and deviation 1 over (height, width); `cells`: texels of its coarsest octave."""
    height, width = size
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        step = max(cells / 2**octave, 1.0)
        shape = (int(height / step) + 3, int(width / step) + 3)
        lumps = rng.standard_normal(shape, np.float32)
        how = cv2.INTER_LINEAR if octave else cv2.INTER_CUBIC  # linear would show the edges of the coarsest cells
        grown = cv2.resize(lumps, (int(shape[1] * step), int(shape[0] * step)), interpolation=how)
        if grown.shape[0] < height or grown.shape[1] < width:
            grown = cv2.resize(lumps, (width, height), interpolation=how)
        for band in bands(height):
            total[band] += grown[band, :width] / 1.7**octave
    deviation = max(float(total.std()), 1e-6)
    total -= total.mean()
    total /= deviation
    return total


def bounded(values: npt.NDArray[np.floating]) -> Pixels:
    """Values as uint8, clipped to 0..255."""
    return np.asarray(np.clip(values, 0, 255), np.uint8)


def tinted(colour: Colour, light: Field) -> Pixels:
    """A colour times a brightness per texel (1: the colour itself)."""
    # OpenCV multiplies, rounds and bounds in one pass; numpy would go over these large arrays four times.
    channels = [cv2.multiply(light, float(part), dtype=cv2.CV_8U) for part in colour]
    return np.asarray(cv2.merge(channels), np.uint8)


def plaster(rng: np.random.Generator, size: tuple[int, int], colour: Colour) -> Pixels:
    """Rendered wall with stains and fine grain."""
    stains = noise(rng, size, 90)
    grain = rng.standard_normal(size, np.float32)
    # Rain runs down: stains that vary across, hardly along.
    runs = cv2.resize(noise(rng, (8, size[1]), 14, 3), (size[1], size[0]), interpolation=cv2.INTER_LINEAR)
    return tinted(colour, 1 + 0.035 * stains + 0.022 * grain + 0.022 * runs)


def brick(rng: np.random.Generator, size: tuple[int, int], colour: Colour, per_metre: int) -> Pixels:
    """Bricks in stretcher bond, each of its own shade, with pale mortar."""
    height, width = size
    tall, wide = max(3, round(0.11 * per_metre)), max(7, round(0.26 * per_metre))
    rows, columns = height // tall + 1, width // wide + 2
    shades = (1 + 0.11 * rng.standard_normal((rows, columns))).astype(np.float32)
    y, x = np.arange(height), np.arange(width)
    row = y // tall
    shifted = x[None, :] + (row % 2)[:, None] * (wide // 2)
    light = shades[row[:, None], shifted // wide]
    mortar = (shifted % wide == 0) | ((y % tall == 0)[:, None])
    wall = tinted(colour, light + 0.03 * noise(rng, size, 60))
    joint = np.clip(np.array(colour) * 0.6 + 75, 0, 255).astype(np.uint8)
    wall[mortar] = joint
    return wall


def panels(rng: np.random.Generator, size: tuple[int, int], colour: Colour, per_metre: int) -> Pixels:
    """Cladding: large panels with dark joints."""
    height, width = size
    tall, wide = round(per_metre * rng.uniform(0.7, 1.3)), round(per_metre * rng.uniform(1.0, 1.8))
    y, x = np.arange(height)[:, None], np.arange(width)[None, :]
    shades = 1 + 0.03 * rng.standard_normal((height // tall + 1, width // wide + 1)).astype(np.float32)
    light = shades[y // tall, x // wide] + 0.015 * noise(rng, size, 80)
    light = np.where((y % tall == 0) | (x % wide == 0), 0.7, light).astype(np.float32)
    return tinted(colour, light)


def boards(rng: np.random.Generator, size: tuple[int, int], colour: Colour, per_metre: int) -> Pixels:
    """Weatherboard: horizontal boards with a shadow under each."""
    height, width = size
    tall = max(5, round(0.18 * per_metre))
    rows = np.arange(height)
    shade = 1 + 0.04 * rng.standard_normal(height // tall + 1).astype(np.float32)[rows // tall]
    shade = shade - 0.3 * (rows % tall == 0) - 0.12 * (rows % tall == 1)
    grain = cv2.resize(rng.standard_normal((height, max(2, width // 12)), np.float32), (width, height))
    return tinted(colour, shade[:, None] + 0.03 * grain)


def asphalt(rng: np.random.Generator, size: tuple[int, int], brightness: float) -> Pixels:
    """Road surface: grain, worn lumps, repaired patches and cracks."""
    light = 1 + 0.10 * noise(rng, size, 120, 5) + 0.08 * rng.standard_normal(size, np.float32)
    height, width = size
    for _ in range(int(rng.integers(2, 7))):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        w, h = int(rng.integers(25, 90)), int(rng.integers(40, 260))
        light[y : y + h, x : x + w] *= float(rng.uniform(0.72, 0.9))
    cracks = np.zeros(size, np.uint8)
    for _ in range(int(rng.integers(5, 12))):
        start = np.array([rng.integers(0, width), rng.integers(0, height)], np.float64)
        steps = rng.normal(0, 9, (30, 2)) + rng.normal(0, 7, 2)
        cv2.polylines(cracks, [np.int32(start + np.cumsum(steps, axis=0))], False, 255, 1, cv2.LINE_AA)
    light *= 1 - 0.45 * (cracks / np.float32(255))
    grey = round(brightness * 255)
    return tinted((grey, grey, min(255, grey + 4)), light)


def paving(
    rng: np.random.Generator, size: tuple[int, int], colour: Colour, slab: tuple[int, int], *, bond: bool = True
) -> Pixels:
    """Slabs of (height, width) texels, each of its own shade, with dark joints."""
    height, width = size
    tall, wide = slab
    y = np.arange(height)
    row = y // tall
    shifted = np.arange(width)[None, :] + ((row % 2) * (wide // 2 if bond else 0))[:, None]
    shades = (1 + 0.07 * rng.standard_normal((height // tall + 1, width // wide + 2))).astype(np.float32)
    light = (
        shades[row[:, None], shifted // wide]
        + 0.05 * noise(rng, size, 70)
        + 0.03 * rng.standard_normal(size, np.float32)
    )
    joint = (shifted % wide < 1) | ((y % tall < 1)[:, None])
    light[joint] = 0.62
    return tinted(colour, light)


def grass(rng: np.random.Generator, size: tuple[int, int], colour: Colour) -> Pixels:
    """Lawn: lumps of lighter and darker green, blades, dry spots."""
    light = 1 + 0.08 * noise(rng, size, 150, 5) + 0.10 * noise(rng, size, 5, 2)
    light += 0.13 * rng.standard_normal(size, np.float32)
    lawn = tinted(colour, light)
    spots = noise(rng, size, 200, 3)
    for band in bands(size[0]):
        dry = np.clip(spots[band] - 0.9, 0, 1)[..., None] * 0.5
        lawn[band] = bounded(lawn[band].astype(np.float32) * (1 - dry) + np.array([165, 150, 90]) * dry)
    return lawn


def roof_tiles(rng: np.random.Generator, size: tuple[int, int], colour: Colour) -> Pixels:
    """Tiles in rows, each overlapping the next."""
    height, width = size
    y, x = np.arange(height)[:, None], np.arange(width)[None, :]
    shades = (1 + 0.1 * rng.standard_normal((height // 7 + 1, width // 8 + 2))).astype(np.float32)
    light = shades[y // 7, (x + (y // 7 % 2) * 4) // 8] * (0.75 + 0.25 * (y % 7) / 6)
    return tinted(colour, (light + 0.06 * noise(rng, size, 60)).astype(np.float32))


def bark(rng: np.random.Generator, size: tuple[int, int], colour: Colour) -> Pixels:
    """Bark: lengthwise furrows on a round stem, lighter in the middle."""
    height, width = size
    furrows = cv2.resize(rng.standard_normal((max(2, height // 10), width), np.float32), (width, height))
    round_ = 0.65 + 0.4 * np.sin(np.linspace(0.15, 3.0, width, dtype=np.float32))[None, :]
    return tinted(colour, round_ + 0.13 * furrows)
