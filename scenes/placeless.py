"""Pictures that show no place: a wall or the ground close by, the sky, a page of text, a screen, a blur."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Pixels
from scenes.notices import HUES, INK, PAPER
from scenes.words import LABELS

SIZE = (480, 640)
"""Height and width."""

Kind = Callable[[np.random.Generator], Pixels]


def placeless(kind: str, seed: int) -> Pixels:
    """A picture of a kind of `KINDS`, uint8 RGB of shape (480, 640, 3); equal arguments give equal pictures."""
    rng = np.random.default_rng([seed, *kind.encode()])
    return _photographed(rng, KINDS[kind](rng))


def _photographed(rng: np.random.Generator, flat: Pixels) -> Pixels:
    """As a camera that is held askew, in uneven light, sees it."""
    height, width = SIZE
    flat = cv2.resize(flat, (width, height), interpolation=cv2.INTER_AREA)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    outwards = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width, height)
    moved = corners + outwards * rng.uniform(0, 0.1, (4, 2))
    matrix = cv2.getPerspectiveTransform(corners, moved.astype(np.float32))
    seen = cv2.warpPerspective(flat, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)
    (left, right), (top, bottom) = rng.uniform(0.7, 1.05, (2, 2))
    light = np.linspace(top, bottom, height)[:, None] * np.linspace(left, right, width)[None, :]
    noise = rng.normal(0, rng.uniform(1, 5), seen.shape).astype(np.float32)
    soft = cv2.GaussianBlur(seen, (0, 0), float(rng.uniform(0.3, 1.1))).astype(np.float32)
    return materials.bounded(soft * light[..., None] + noise)


def _colour(rng: np.random.Generator, least: int = 70, most: int = 235) -> materials.Colour:
    """A colour that is more grey than not."""
    grey = rng.uniform(least, most)
    red, green, blue = np.clip(grey + rng.normal(0, 18, 3), 20, 250).astype(int).tolist()
    return red, green, blue


def _page(rng: np.random.Generator) -> Pixels:
    """Lines of words in one to three columns."""
    ground = np.full((*SIZE, 3), _colour(rng, 215, 250), np.uint8)
    columns, size = int(rng.integers(1, 4)), float(rng.uniform(0.35, 1.0))
    font = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_COMPLEX, cv2.FONT_HERSHEY_PLAIN]))
    margin, step = int(rng.integers(8, 50)), round(rng.uniform(26, 42) * size)
    wide = (SIZE[1] - margin * (columns + 1)) // columns
    for column in range(columns):
        left = margin + column * (wide + margin)
        y = int(rng.integers(step, 2 * step))
        while y < SIZE[0]:
            _line(rng, ground, font, size, left, y, int(wide * (rng.uniform(0.2, 0.9) if rng.random() < 0.2 else 1)))
            y += step * (2 if rng.random() < 0.12 else 1)
    return ground


def _line(rng: np.random.Generator, ground: Pixels, font: int, size: float, left: int, y: int, wide: int) -> None:
    """Write words until the line is full."""
    x = left
    while True:
        word = "".join(rng.choice(list("eeetaoinshrdlucmfwygpb"), int(rng.integers(2, 10))))
        (long, _), _ = cv2.getTextSize(word, font, size, 1)
        if x + long > left + wide:
            return
        cv2.putText(ground, word, (x, y), font, size, INK, 1, cv2.LINE_AA)
        x += long + round(14 * size)


def _screen(rng: np.random.Generator) -> Pixels:
    """A bar above cards with a picture and a few words each."""
    dark = bool(rng.random() < 0.4)
    ground = np.full((*SIZE, 3), _colour(rng, 18, 45) if dark else _colour(rng, 225, 250), np.uint8)
    accent = HUES[rng.integers(len(HUES))]
    bar = int(rng.integers(30, 70))
    ground[:bar] = accent
    cv2.putText(ground, str(rng.choice(LABELS)), (16, bar - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.7, PAPER, 1, cv2.LINE_AA)
    across, tall = int(rng.integers(1, 4)), int(rng.integers(70, 200))
    wide = (SIZE[1] - 8) // across
    for top in range(bar + 8, SIZE[0], tall + 8):
        for column in range(across):
            left, right = 8 + column * wide, (column + 1) * wide
            ground[top : top + tall, left:right] = (38, 40, 48) if dark else (252, 252, 252)
            shown = ground[top + 6 : top + int(tall * rng.uniform(0.3, 0.7)), left + 6 : right - 6]
            shown[:] = _blend(rng, shown.shape[:2])
            for line in range(top + int(tall * 0.85), min(top + tall, SIZE[0]), 16):
                words = " ".join(rng.choice(LABELS, 3))[: (right - left) // 9]
                at = (left + 8, line)
                cv2.putText(ground, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, PAPER if dark else INK, 1, cv2.LINE_AA)
    return ground


def _blend(rng: np.random.Generator, size: tuple[int, int]) -> Pixels:
    """From one colour to another."""
    first, second = (np.array(HUES[i]) for i in rng.choice(len(HUES), 2, replace=False))
    share = np.linspace(0, 1, max(size[1], 1))[None, :, None] * np.ones((max(size[0], 1), 1, 1))
    return materials.bounded(first * (1 - share) + second * share)[: size[0], : size[1]]


def _sky(rng: np.random.Generator) -> Pixels:
    """Clouds, from none to a closed cover, of any light."""
    clouds = np.clip((materials.noise(rng, SIZE, float(rng.uniform(150, 400)), 7) - rng.uniform(-2, 1.5)) / 1.5, 0, 1)
    blue = np.array([rng.uniform(50, 150), rng.uniform(120, 190), rng.uniform(190, 250)])
    height = np.linspace(rng.uniform(0.7, 1), rng.uniform(0.95, 1.15), SIZE[0])[:, None, None]
    white = np.array([238, 240, 244]) * rng.uniform(0.6, 1)
    return materials.bounded(blue * height * (1 - clouds[..., None]) + white * clouds[..., None])


def _blurred(rng: np.random.Generator) -> Pixels:
    """Patches of colour without an edge, as of a lens that touches something."""
    patches = rng.integers(20, 240, (int(rng.integers(2, 6)), int(rng.integers(2, 7)), 3)).astype(np.uint8)
    return np.asarray(cv2.resize(patches, SIZE[::-1], interpolation=cv2.INTER_CUBIC), np.uint8)


def _stripes(rng: np.random.Generator) -> Pixels:
    """Blinds, grilles or corrugated sheet."""
    period, turned = int(rng.integers(8, 60)), bool(rng.random() < 0.5)
    side = SIZE[1] if turned else SIZE[0]
    wave = 1 + rng.uniform(0.1, 0.4) * np.sin(np.arange(side) * 2 * np.pi / period) ** int(rng.choice([1, 3]))
    light = np.broadcast_to(wave[None, :] if turned else wave[:, None], SIZE).astype(np.float32)
    return materials.tinted(_colour(rng), np.ascontiguousarray(light + 0.03 * materials.noise(rng, SIZE, 80)))


def _leaves(rng: np.random.Generator) -> Pixels:
    """Foliage close by: lumps of light and shade at every size."""
    light = 0.8 + 0.25 * materials.noise(rng, SIZE, float(rng.uniform(20, 120)), 6)
    green: materials.Colour = (int(rng.integers(50, 120)), int(rng.integers(90, 150)), int(rng.integers(30, 80)))
    return materials.tinted(green, np.clip(light, 0.05, 2).astype(np.float32))


def _plain(rng: np.random.Generator) -> Pixels:
    """A smooth wall, door or ceiling."""
    return materials.tinted(_colour(rng), 1 + np.float32(rng.uniform(0.002, 0.02)) * materials.noise(rng, SIZE, 200))


def _per_metre(rng: np.random.Generator) -> int:
    return int(rng.integers(120, 700))


KINDS: Mapping[str, Kind] = {
    "page": _page,
    "screen": _screen,
    "sky": _sky,
    "blurred": _blurred,
    "stripes": _stripes,
    "leaves": _leaves,
    "plain": _plain,
    "plaster": lambda rng: materials.plaster(rng, SIZE, _colour(rng)),
    "brick": lambda rng: materials.brick(rng, SIZE, (int(rng.integers(110, 180)), 82, 66), _per_metre(rng)),
    "panels": lambda rng: materials.panels(rng, SIZE, _colour(rng), _per_metre(rng) // 2),
    "boards": lambda rng: materials.boards(rng, SIZE, _colour(rng), _per_metre(rng)),
    "asphalt": lambda rng: materials.asphalt(rng, SIZE, float(rng.uniform(0.25, 0.6))),
    "paving": lambda rng: materials.paving(rng, SIZE, _colour(rng), (_per_metre(rng) // 4, _per_metre(rng) // 3)),
    "grass": lambda rng: materials.grass(rng, SIZE, (int(rng.integers(70, 110)), 128, 60)),
    "bark": lambda rng: materials.bark(rng, SIZE, (120, 96, 74)),
}
"""Kinds by their names."""
