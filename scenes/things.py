"""Passing things, which do not belong to a place: a bus, a car, a person."""

import cv2
import numpy as np

from scenes.geometry import Pixels, Sprite, Surface, box, standing, vector
from scenes.materials import Colour, bounded
from scenes.words import label

BUS, CAR, PERSON = label("bus"), label("car"), label("person")
PAINTS: tuple[Colour, ...] = (
    (176, 30, 34), (30, 84, 150), (218, 176, 40), (236, 236, 232), (44, 110, 70), (60, 62, 66), (150, 152, 156),
)  # fmt: skip


def bus(rng: np.random.Generator, x: float, y: float, heading: float) -> list[Surface]:
    """A city bus, 11 m long; at heading 0 its rear is towards the viewer."""
    paint = PAINTS[rng.integers(5)]
    length, width, height, floor = 11.0, 2.55, 3.1, 0.35
    per_metre = 40
    side = _body(paint, height - floor, length, per_metre)
    rows = side.shape[0]
    band = slice(round(0.35 * per_metre), round(1.5 * per_metre))
    for i in range(7):
        left = round((0.5 + i * 1.45) * per_metre)
        side[band, left : left + round(1.3 * per_metre)] = _pane(band.stop - band.start, round(1.3 * per_metre))
    glow = np.zeros_like(side)
    glow[band] = np.where(side[band] < 130, 150, 0).astype(np.uint8) * np.array([1.0, 0.93, 0.75])
    side[round(1.85 * per_metre) : round(1.95 * per_metre)] = (240, 240, 236)
    for wheel in (2.2, 8.4):
        at = (round(wheel * per_metre), rows - 6)
        cv2.circle(side, at, 22, (18, 18, 18), -1, cv2.LINE_AA)
        cv2.circle(side, at, 11, (120, 122, 124), -1, cv2.LINE_AA)
    rear = _body(paint, height - floor, width, per_metre)
    window = (slice(round(0.3 * per_metre), round(1.3 * per_metre)), slice(12, rear.shape[1] - 12))
    rear[window] = _pane(window[0].stop - window[0].start, window[1].stop - window[1].start)
    cv2.putText(rear, str(rng.integers(1, 99)), (34, 11), cv2.FONT_HERSHEY_DUPLEX, 0.42, (255, 190, 60), 1, cv2.LINE_AA)
    shine = np.zeros_like(rear)
    for lamp in (6, rear.shape[1] - 16):
        rear[-36:-22, lamp : lamp + 10] = (190, 24, 22)
        shine[-36:-22, lamp : lamp + 10] = (255, 40, 30)
    rear[-16:] = (34, 34, 36)
    cv2.rectangle(rear, (38, rear.shape[0] - 34), (64, rear.shape[0] - 26), (236, 232, 214), -1)
    roof = np.full((24, 24, 3), 205, np.uint8)
    x0, x1, y1 = -width / 2, width / 2, length
    down = vector(0, 0, floor - height)
    parts = [
        Surface(vector(x0, 0, height), vector(width, 0, 0), down, rear, BUS, shine),
        Surface(vector(x1, y1, height), vector(-width, 0, 0), down, rear, BUS),
        Surface(vector(x1, 0, height), vector(0, length, 0), down, side, BUS, glow),
        Surface(vector(x0, y1, height), vector(0, -length, 0), down, side, BUS, glow),
        Surface(vector(x0, y1, height), vector(width, 0, 0), vector(0, -length, 0), roof, BUS),
    ]
    dark = np.full((8, 8, 3), 22, np.uint8)
    for wheel in (2.2, 8.4):
        parts += box((x0 + 0.1, x1 - 0.1), (wheel - 0.5, wheel + 0.5), (0, 0.6), dark, BUS)
    parts += box((x0 + 0.15, x1 - 0.15), (0.15, length - 0.15), (0.2, floor), dark, BUS)
    return standing(parts, x, y, heading)


def car(rng: np.random.Generator, x: float, y: float, heading: float) -> list[Surface]:
    """A car, 4.3 m long; at heading 0 its rear is towards the viewer."""
    paint = PAINTS[rng.integers(len(PAINTS))]
    length, width = 4.3, 1.8
    per_metre = 60
    flank = _body(paint, 0.65, length, per_metre)
    for wheel in (0.8, 3.45):
        cv2.circle(flank, (round(wheel * per_metre), flank.shape[0] + 2), 23, (16, 16, 16), -1, cv2.LINE_AA)
        cv2.circle(flank, (round(wheel * per_metre), flank.shape[0] + 2), 12, (150, 152, 154), -1, cv2.LINE_AA)
    cv2.line(flank, (round(2.2 * per_metre), 0), (round(2.2 * per_metre), 30), (30, 30, 30), 1)
    rear = _body(paint, 0.65, width, per_metre)
    shine = np.zeros_like(rear)
    for lamp in (2, rear.shape[1] - 20):
        rear[4:13, lamp : lamp + 18] = (180, 22, 22)
        shine[4:13, lamp : lamp + 18] = (255, 40, 30)
    cv2.rectangle(rear, (38, 16), (70, 24), (238, 236, 226), -1)
    rear[-9:] = (36, 36, 38)
    hood = np.full((24, 24, 3), np.clip(np.array(paint) * 1.05, 0, 255), np.uint8)
    x0, x1 = -width / 2, width / 2
    low, belt, roof = 0.28, 0.93, 1.46
    down = vector(0, 0, low - belt)
    parts = [
        Surface(vector(x0, 0, belt), vector(width, 0, 0), down, rear, CAR, shine),
        Surface(vector(x1, length, belt), vector(-width, 0, 0), down, rear, CAR),
        Surface(vector(x1, 0, belt), vector(0, length, 0), down, flank, CAR),
        Surface(vector(x0, length, belt), vector(0, -length, 0), down, flank, CAR),
        Surface(vector(x0, length, belt), vector(width, 0, 0), vector(0, -length, 0), hood, CAR),
    ]
    # The cabin: sloping panes between belt line and roof.
    glass = _pane(40, 80)
    framed = glass.copy()
    cv2.rectangle(framed, (0, 0), (79, 39), paint, 4)
    cv2.line(framed, (40, 0), (40, 39), paint, 3)
    a, b, c, d = 0.25, 0.75, 2.5, 3.3
    inset = 0.16
    top0, top1 = x0 + inset, x1 - inset
    parts += [
        Surface(vector(top0, b, roof), vector(top1 - top0, 0, 0), vector(0, a - b, belt - roof), glass, CAR),
        Surface(vector(top1, c, roof), vector(top0 - top1, 0, 0), vector(0, d - c, belt - roof), glass, CAR),
        Surface(vector(top1, b, roof), vector(0, c - b, 0), vector(inset, 0, belt - roof), framed, CAR),
        Surface(vector(top0, c, roof), vector(0, b - c, 0), vector(-inset, 0, belt - roof), framed, CAR),
        Surface(vector(top0, c, roof), vector(top1 - top0, 0, 0), vector(0, b - c, 0), hood, CAR),
    ]
    dark = np.full((8, 8, 3), 18, np.uint8)
    for wheel in (0.8, 3.45):
        parts += box((x0 + 0.02, x1 - 0.02), (wheel - 0.31, wheel + 0.31), (0, 0.5), dark, CAR)
    return standing(parts, x, y, heading)


def person(rng: np.random.Generator, x: float, y: float) -> Sprite:
    """A walking person seen from the side, 1.75 m tall."""
    texture = np.zeros((280, 140, 4), np.uint8)
    coat = (*PAINTS[rng.integers(len(PAINTS))], 255)
    trousers = (*((40, 44, 60), (70, 60, 50), (30, 30, 32))[rng.integers(3)], 255)
    skin = (*((224, 184, 156), (150, 104, 78), (98, 66, 50))[rng.integers(3)], 255)
    hair = (*((46, 34, 26), (20, 18, 18), (150, 116, 70), (140, 140, 140))[rng.integers(4)], 255)
    stride = int(rng.integers(16, 30))
    for reach in (-stride, stride):
        cv2.line(texture, (70, 148), (70 + reach // 2, 205), trousers, 20, cv2.LINE_AA)
        cv2.line(texture, (70 + reach // 2, 205), (70 + reach, 262), trousers, 16, cv2.LINE_AA)
        cv2.ellipse(texture, (76 + reach, 268), (15, 7), 0, 0, 360, (28, 26, 26, 255), -1, cv2.LINE_AA)
    dark = tuple(int(c * 0.75) for c in coat[:3])
    cv2.line(texture, (66, 72), (92, 112), (*dark, 255), 14, cv2.LINE_AA)
    body = np.array([[48, 66], [62, 54], [82, 54], [94, 66], [92, 158], [50, 158]], np.int32)
    cv2.fillPoly(texture, [body], coat, cv2.LINE_AA)
    cv2.line(texture, (70, 74), (50, 132), (*(int(c * 0.85) for c in coat[:3]), 255), 15, cv2.LINE_AA)
    cv2.circle(texture, (48, 138), 7, skin, -1, cv2.LINE_AA)
    cv2.line(texture, (72, 56), (72, 44), skin, 14, cv2.LINE_AA)
    cv2.ellipse(texture, (73, 28), (16, 21), 0, 0, 360, skin, -1, cv2.LINE_AA)
    cv2.ellipse(texture, (70, 20), (18, 15), 0, 150, 400, hair, -1, cv2.LINE_AA)
    return Sprite(vector(x, y, 0.875), 0.875, 1.75, texture, PERSON, 1.0)


def _body(paint: Colour, height: float, length: float, per_metre: int) -> Pixels:
    """Painted sheet metal: the sky is reflected above, the road below."""
    rows, columns = round(height * per_metre), round(length * per_metre)
    t = np.linspace(0, 1, rows, dtype=np.float32)
    shade = 1.08 - 0.3 * t + 0.1 * np.exp(-(((t - 0.25) / 0.07) ** 2))
    return bounded(np.array(paint, np.float32) * shade[:, None, None] * np.ones((1, columns, 1)))


def _pane(rows: int, columns: int) -> Pixels:
    ramp = np.linspace(0.9, 0.35, rows)[:, None, None]
    slant = np.where((np.arange(columns)[None, :] + np.arange(rows)[:, None]) % 50 < 14, 1.18, 1.0)[..., None]
    return bounded(np.array([96, 108, 118]) * ramp * slant)
