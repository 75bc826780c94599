"""Furniture of streets and parks: lamp posts, signs, fences, benches, bollards, bins."""

import math

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Lamp, Pixels, Place, Surface, box, standing, vector
from scenes.materials import Colour
from scenes.words import label

POLE, SIGN, FENCE, BENCH = label("pole"), label("sign"), label("fence"), label("bench")


def metal(colour: Colour, rows: int = 64, columns: int = 16) -> Pixels:
    """A round, painted bar: light in the middle, dark at the edges."""
    shade = 0.55 + 0.6 * np.sin(np.linspace(0.2, 2.9, columns, dtype=np.float32))
    return materials.tinted(colour, np.broadcast_to(shade, (rows, columns)).astype(np.float32))


def bar(x: float, y: float, z0: float, z1: float, thickness: float, texture: Pixels) -> list[Surface]:
    """An upright bar as a narrow box."""
    t = thickness / 2
    return box((x - t, x + t), (y - t, y + t), (z0, z1), texture, POLE)


def lamp_post(
    place: Place, x: float, y: float, height: float, towards: float, colour: Colour, *, style: int = 0
) -> None:
    """A street lamp with an arm that reaches `towards` metres along x (style 0), or with a globe (style 1)."""
    texture = metal(colour)
    parts = bar(0, 0, 0, height, 0.13, texture) + bar(0, 0, 0, 0.7, 0.24, texture)
    glass = np.full((8, 8, 3), 224, np.uint8)
    shine = np.full((8, 8, 3), (255, 232, 190), np.uint8)
    if style == 0:
        reach = (min(0, towards), max(0, towards))
        parts += box(reach, (-0.05, 0.05), (height - 0.08, height), texture, POLE)
        head = box((towards - 0.35, towards + 0.35), (-0.14, 0.14), (height - 0.16, height - 0.02), texture, POLE)
        under = box((towards - 0.28, towards + 0.28), (-0.11, 0.11), (height - 0.22, height - 0.16), glass, POLE)
        position = (x + towards, y, height - 0.4)
    else:
        head = box((-0.1, 0.1), (-0.1, 0.1), (height + 0.4, height + 0.48), texture, POLE)
        under = box((-0.2, 0.2), (-0.2, 0.2), (height, height + 0.4), glass, POLE)
        position = (x, y, height + 0.1)
    shining = [Surface(f.origin, f.across, f.down, f.texture, f.label, shine) for f in under]
    place.surfaces += standing(parts + head + shining, x, y, 0)
    place.lamps.append(Lamp(position, (2.3, 1.85, 1.25), reach=3.0))
    place.shadows.append(np.array([[x - 0.1, y - 0.1, height], [x + 0.1, y + 0.1, height]]))


def sign_face(rng: np.random.Generator, kind: int) -> Pixels:
    """The face of a traffic sign, RGBA 96 x 96."""
    face = np.zeros((96, 96, 4), np.uint8)
    red, blue, white, black = (190, 26, 34, 255), (24, 76, 160, 255), (240, 240, 236, 255), (20, 20, 20, 255)
    if kind == 0:
        cv2.circle(face, (48, 48), 46, red, -1, cv2.LINE_AA)
        cv2.circle(face, (48, 48), 35, white, -1, cv2.LINE_AA)
        cv2.putText(face, str(rng.choice(["30", "50", "20"])), (17, 62), cv2.FONT_HERSHEY_DUPLEX, 1.6, black, 4)
    elif kind == 1:
        for inset, colour in ((0, red), (14, white)):
            points = np.array(
                [[48, 4 + inset * 1.4], [94 - inset * 1.2, 88 - inset * 0.7], [2 + inset * 1.2, 88 - inset * 0.7]]
            )
            cv2.fillPoly(face, [np.int32(points)], colour, cv2.LINE_AA)
        cv2.rectangle(face, (45, 40), (51, 66), black, -1)
        cv2.circle(face, (48, 74), 4, black, -1)
    elif kind == 2:
        face[:] = blue
        cv2.rectangle(face, (3, 3), (92, 92), white, 3)
        cv2.putText(face, str(rng.choice(["P", "H", "M", "i"])), (26, 74), cv2.FONT_HERSHEY_DUPLEX, 2.4, white, 6)
    else:
        points = np.array([[28, 2], [68, 2], [94, 28], [94, 68], [68, 94], [28, 94], [2, 68], [2, 28]], np.int32)
        cv2.fillPoly(face, [points], red, cv2.LINE_AA)
        cv2.putText(face, "STOP", (11, 60), cv2.FONT_HERSHEY_DUPLEX, 0.95, white, 3, cv2.LINE_AA)
    return face


def sign(place: Place, rng: np.random.Generator, x: float, y: float, *, faces: int = 1) -> None:
    """A post with one or two traffic signs that face -y."""
    texture = metal((150, 152, 154))
    place.surfaces += bar(x, y, 0, 2.5 + 0.65 * faces, 0.07, texture)
    for i in range(faces):
        z = 2.85 + 0.68 * i
        face = sign_face(rng, int(rng.integers(4)))
        place.surfaces.append(
            Surface(vector(x - 0.32, y - 0.06, z + 0.32), vector(0.64, 0, 0), vector(0, 0, -0.64), face, SIGN)
        )


def traffic_light(place: Place, x: float, y: float, towards: float) -> None:
    """A traffic light on a mast with an arm over the road."""
    texture = metal((70, 74, 72))
    place.surfaces += bar(x, y, 0, 5.4, 0.16, texture)
    ends = (min(x, x + towards), max(x, x + towards))
    place.surfaces += box(ends, (y - 0.05, y + 0.05), (5.2, 5.34), texture, POLE)
    face = np.full((72, 28, 3), (26, 28, 28), np.uint8)
    glow = np.zeros_like(face)
    for i, colour in enumerate(((220, 40, 36), (90, 70, 20), (20, 70, 40))):
        cv2.circle(face, (14, 13 + 23 * i), 9, colour, -1, cv2.LINE_AA)
    cv2.circle(glow, (14, 13), 9, (255, 60, 50), -1, cv2.LINE_AA)
    for at in (x, x + towards * 0.95):
        z = 3.4 if at == x else 5.9
        place.surfaces.append(
            Surface(vector(at - 0.18, y - 0.12, z), vector(0.36, 0, 0), vector(0, 0, -0.95), face, SIGN, glow)
        )


def fence(
    place: Place, rng: np.random.Generator, start: tuple[float, float], end: tuple[float, float], height: float
) -> None:
    """A railing or a board fence between two points."""
    (x0, y0), (x1, y1) = start, end
    length = math.hypot(x1 - x0, y1 - y0)
    columns, rows = max(4, round(length * 28)), round(height * 36)
    texture = np.zeros((rows, columns, 4), np.uint8)
    if rng.random() < 0.5:
        colour = np.array([(30, 34, 32), (44, 56, 70), (120, 122, 120)][rng.integers(3)])
        for x in range(0, columns, 4):
            texture[:, x] = (*colour, 255)
        for x in range(0, columns, 70):
            texture[:, x : x + 4] = (*colour, 255)
        for y in (2, rows - 8):
            texture[y : y + 3] = (*np.clip(colour + 14, 0, 255), 255)
    else:
        wood = [(150, 118, 82), (226, 222, 212), (108, 96, 84)][rng.integers(3)]
        texture[..., :3] = materials.bark(rng, (rows, columns), wood)
        texture[..., 3] = 255
        texture[:, ::7, 3] = 0
        texture[rows // 5 : rows // 5 + 4, :, 3] = 255
        texture[-rows // 4 : -rows // 4 + 4, :, 3] = 255
    piece = 6.0
    pieces = max(1, round(length / piece))
    for i in range(pieces):  # short pieces, each drawn at the resolution that its distance needs
        a, b = i / pieces, (i + 1) / pieces
        cut = np.ascontiguousarray(texture[:, round(a * columns) : round(b * columns)])
        origin = vector(x0 + a * (x1 - x0), y0 + a * (y1 - y0), height)
        across = vector((x1 - x0) / pieces, (y1 - y0) / pieces, 0)
        place.surfaces.append(Surface(origin, across, vector(0, 0, -height), cut, FENCE))


def bench(place: Place, rng: np.random.Generator, x: float, y: float, heading: float) -> None:
    """A park bench with a slatted back."""
    slats = np.zeros((24, 48, 4), np.uint8)
    slats[..., :3] = materials.bark(rng, (24, 48), (140, 98, 58))
    slats[..., 3] = np.where(np.arange(24) % 8 < 6, 255, 0)[:, None]
    iron = np.full((8, 8, 3), (40, 42, 44), np.uint8)
    parts = [
        Surface(vector(-0.9, 0.25, 0.92), vector(1.8, 0, 0), vector(0, 0, -0.45), slats, BENCH),
        Surface(vector(-0.9, 0.25, 0.46), vector(1.8, 0, 0), vector(0, -0.5, 0), slats, BENCH),
    ]
    for side in (-0.8, 0.74):
        parts += box((side, side + 0.06), (-0.22, 0.25), (0, 0.44), iron, BENCH)
    place.surfaces += standing(parts, x, y, heading)
    corners = np.array([[-0.9, -0.3, 0.6], [0.9, -0.3, 0.6], [0.9, 0.3, 0.6], [-0.9, 0.3, 0.6]])
    place.shadows.append(corners + np.array([x, y, 0]))


def bin_(place: Place, x: float, y: float, colour: Colour) -> None:
    """A litter bin."""
    place.surfaces += box((x - 0.22, x + 0.22), (y - 0.22, y + 0.22), (0.1, 0.95), metal(colour), BENCH)


def bollards(place: Place, x: float, ys: list[float], colour: Colour) -> None:
    """A row of bollards along a kerb."""
    texture = metal(colour)
    for y in ys:
        place.surfaces += bar(x, y, 0, 0.95, 0.16, texture)
