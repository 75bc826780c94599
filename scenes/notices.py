"""What tells floors of a building apart: number plates, level signs, posters, notice boards, as RGB textures."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from scenes import materials
from scenes.geometry import Pixels
from scenes.materials import Colour

PER_METRE = 220
"""Texels; four times as fine as walls, so that letters can be read from two metres."""

INK: Colour = (34, 36, 40)
PAPER: Colour = (244, 242, 234)
HUES: tuple[Colour, ...] = (
    (178, 62, 48), (44, 98, 148), (58, 122, 84), (204, 152, 52), (112, 72, 132), (52, 128, 136), (196, 106, 60),
    (92, 96, 104),
)  # fmt: skip
TITLES = (
    "JAZZ", "CHOIR", "OPEN DAY", "CHESS", "FIRST AID", "BOOKS", "RUN 10K", "LUNCH", "YOGA", "MAPS", "TALKS", "CYCLE",
    "MUSEUM", "THEATRE", "GARDEN", "FILM", "SWIM", "HARBOUR", "ALPS", "MARKET",
)  # fmt: skip
FIRMS = (
    "ARDEN & CO", "NORTHLIGHT", "HALE MAPS", "KESTREL", "TIDEWELL", "BRACKEN LAW", "OSTER LABS", "PENROSE", "VALE INK",
    "COPPERWAY",
)  # fmt: skip


def sheet(width: float, height: float, colour: Colour) -> Pixels:
    """A plain sheet; sides in metres."""
    return np.full((round(height * PER_METRE), round(width * PER_METRE), 3), colour, np.uint8)


def lettered(image: Pixels, text: str, area: tuple[float, float, float, float], colour: Colour) -> None:
    """Write a line as large as fits the middle of an area: left, top, right, bottom as shares of the image."""
    height, width = image.shape[:2]
    left, top, right, bottom = area[0] * width, area[1] * height, area[2] * width, area[3] * height
    (wide, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, 1.0, 1)
    scale = min((right - left) / wide, (bottom - top) / tall)
    thickness = max(1, round(scale * tall * 0.1))
    at = (round((left + right - wide * scale) / 2), round((top + bottom + tall * scale) / 2))
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_DUPLEX, scale, colour, thickness, cv2.LINE_AA)


def framed(image: Pixels, colour: Colour, metres: float) -> Pixels:
    """The image with a border painted over its edges."""
    side = max(1, round(metres * PER_METRE))
    image[:side], image[-side:], image[:, :side], image[:, -side:] = colour, colour, colour, colour
    return image


def number_plate(number: int, accent: Colour) -> Pixels:
    """The plate of a door, 26 x 17 cm."""
    plate = sheet(0.26, 0.17, PAPER)
    plate[:, : round(0.03 * PER_METRE)] = accent
    lettered(plate, str(number), (0.18, 0.18, 0.95, 0.82), INK)
    return plate


def level_sign(floor: int, accent: Colour) -> Pixels:
    """The sign that says which floor this is, 36 x 46 cm."""
    sign = sheet(0.36, 0.46, accent)
    lettered(sign, "LEVEL", (0.16, 0.08, 0.84, 0.24), PAPER)
    lettered(sign, str(floor), (0.2, 0.34, 0.8, 0.92), PAPER)
    return sign


def direction_sign(floor: int, doors: int, accent: Colour, band: Colour) -> Pixels:
    """Numbers of the rooms ahead on a white board of 80 x 30 cm, with a coloured band."""
    sign = sheet(0.8, 0.3, PAPER)
    middle = max(1, doors // 2)
    lettered(sign, f"{floor}01 - {floor}{middle:02d}", (0.06, 0.12, 0.8, 0.38), INK)
    lettered(sign, f"{floor}{middle + 1:02d} - {floor}{doors:02d}", (0.06, 0.48, 0.8, 0.74), INK)
    height, width = sign.shape[:2]
    arrow = np.array([[0.86, 0.42], [0.91, 0.2], [0.96, 0.42]]) * (width, height)
    cv2.fillPoly(sign, [np.int32(arrow)], accent, cv2.LINE_AA)
    sign[round(0.84 * height) :] = band
    return sign


def company_sign(rng: np.random.Generator, name: str, width: float, height: float, ground: Colour) -> Pixels:
    """Name and emblem of a firm on the colour of the wall."""
    sign = sheet(width, height, ground)
    colour = HUES[rng.integers(len(HUES))]
    tall = sign.shape[0]
    centre, radius = (round(tall * 0.5), round(tall * 0.5)), round(tall * 0.32)
    shape = int(rng.integers(3))
    if shape == 0:
        cv2.circle(sign, centre, radius, colour, round(radius * 0.4), cv2.LINE_AA)
    elif shape == 1:
        points = np.array([[0, -1], [0.95, 0.8], [-0.95, 0.8]]) * radius + centre
        cv2.fillPoly(sign, [np.int32(points)], colour, cv2.LINE_AA)
    else:
        for i in range(3):
            x = centre[0] - radius + round(i * radius * 0.75)
            cv2.rectangle(
                sign, (x, centre[1] + radius - (i + 1) * radius // 2), (x + radius // 2, centre[1] + radius), colour, -1
            )
    lettered(sign, name, (tall / sign.shape[1], 0.24, 0.97, 0.76), INK)
    return sign


def directory(firms: Sequence[str], floor: int, width: float, height: float) -> Pixels:
    """Which firm is on which floor, the lowest last; this floor's line is marked."""
    board = framed(sheet(width, height, (48, 52, 58)), (150, 152, 154), 0.02)
    for line, level in enumerate(range(len(firms), 0, -1)):
        top, tall = 0.05 + 0.91 * line / len(firms), 0.91 / len(firms)
        if level == floor:
            rows = slice(round(top * board.shape[0]), round((top + 0.9 * tall) * board.shape[0]))
            board[rows, board.shape[1] // 20 : -board.shape[1] // 20] = (184, 140, 52)
        lettered(board, str(level), (0.06, top + 0.2 * tall, 0.2, top + 0.7 * tall), PAPER)
        lettered(board, firms[level - 1], (0.26, top + 0.2 * tall, 0.92, top + 0.7 * tall), PAPER)
    return board


def lift_display(floor: int) -> tuple[Pixels, Pixels]:
    """(Texture, glow) of the display over a lift: this floor's number in amber, 34 x 20 cm."""
    panel, glow = sheet(0.34, 0.2, (22, 22, 24)), sheet(0.34, 0.2, (0, 0, 0))
    for image in (panel, glow):
        lettered(image, str(floor), (0.34, 0.14, 0.86, 0.86), (240, 150, 40))
        height, width = image.shape[:2]
        arrow = np.array([[0.14, 0.62], [0.22, 0.36], [0.3, 0.62]]) * (width, height)
        cv2.fillPoly(image, [np.int32(arrow)], (240, 150, 40), cv2.LINE_AA)
    return panel, glow


def poster(rng: np.random.Generator, width: float, height: float) -> Pixels:
    """A framed poster: a drawing of one of five designs over a title."""
    image = sheet(width, height, PAPER)
    rows, columns = image.shape[:2]
    first, second = (HUES[i] for i in rng.choice(len(HUES), 2, replace=False))
    DESIGNS[rng.integers(len(DESIGNS))](rng, image[: round(0.76 * rows)], first, second)
    lettered(image, str(rng.choice(TITLES)), (0.14, 0.8, 0.86, 0.88), first)
    for line in (0.91, 0.94):
        y, half = round(line * rows), round(columns * float(rng.uniform(0.18, 0.36)))
        cv2.line(image, (columns // 2 - half, y), (columns // 2 + half, y), (120, 120, 122), 2)
    return framed(image, (62, 60, 58), 0.02)


def _hills(rng: np.random.Generator, image: Pixels, first: Colour, second: Colour) -> None:
    rows, columns = image.shape[:2]
    image[:] = (206, 216, 220)
    cv2.circle(
        image, (round(columns * rng.uniform(0.2, 0.8)), round(rows * 0.3)), columns // 8, second, -1, cv2.LINE_AA
    )
    for layer in range(3):
        crest = rows * (0.45 + 0.17 * layer) + rows * 0.08 * materials.noise(rng, (2, columns), columns / 3, 2)[0]
        for x in range(columns):
            image[int(np.clip(crest[x], 0, rows)) :, x] = np.array(first) * (1.15 - 0.25 * layer)


def _rings(rng: np.random.Generator, image: Pixels, first: Colour, second: Colour) -> None:
    rows, columns = image.shape[:2]
    image[:] = second
    centre = (round(columns * rng.uniform(0.3, 0.7)), round(rows * rng.uniform(0.35, 0.65)))
    steps = int(rng.integers(3, 7))
    for i in range(steps):
        radius = round(columns * 0.46 * (1 - i / steps))
        cv2.circle(image, centre, radius, PAPER if i % 2 else first, -1, cv2.LINE_AA)


def _slants(rng: np.random.Generator, image: Pixels, first: Colour, second: Colour) -> None:
    rows, columns = image.shape[:2]
    period, slope = float(rng.uniform(0.2, 0.45)) * columns, float(rng.choice([-1.0, -0.5, 0.5, 1.0]))
    phase = (np.arange(columns)[None, :] + slope * np.arange(rows)[:, None]) % period
    image[:] = np.where((phase < period / 2)[..., None], first, second)


def _blocks(rng: np.random.Generator, image: Pixels, first: Colour, second: Colour) -> None:
    rows, columns = image.shape[:2]
    image[:] = (232, 226, 210)
    across, down = int(rng.integers(2, 5)), int(rng.integers(3, 6))
    for i in range(across):
        for j in range(down):
            if rng.random() < 0.6:
                corners = (
                    (i * columns // across + 4, j * rows // down + 4),
                    ((i + 1) * columns // across - 4, (j + 1) * rows // down - 4),
                )
                cv2.rectangle(image, *corners, (first, second, INK)[rng.integers(3)], -1)


def _notice(rng: np.random.Generator, image: Pixels, first: Colour, second: Colour) -> None:
    rows, columns = image.shape[:2]
    image[: round(0.22 * rows)] = first
    lettered(image, str(rng.choice(TITLES)), (0.12, 0.06, 0.88, 0.17), PAPER)
    for y in range(round(0.3 * rows), round(0.66 * rows), max(4, rows // 18)):
        cv2.line(image, (columns // 8, y), (round(columns * float(rng.uniform(0.5, 0.88))), y), (110, 110, 112), 3)
    x = round(columns * float(rng.uniform(0.1, 0.5)))
    cv2.rectangle(image, (x, round(0.72 * rows)), (x + columns // 3, round(0.96 * rows)), second, -1)


Design = Callable[[np.random.Generator, Pixels, Colour, Colour], None]
DESIGNS: tuple[Design, ...] = (_hills, _rings, _slants, _blocks, _notice)


def notice_board(rng: np.random.Generator, width: float, height: float, ground: Colour) -> Pixels:
    """A notice board with sheets of paper pinned to it."""
    board = sheet(width, height, ground)
    rows, columns = board.shape[:2]
    papers: tuple[Colour, ...] = ((250, 248, 240), (250, 248, 240), (250, 232, 130), (186, 216, 238), (242, 188, 186))
    for _ in range(int(rng.integers(4, 9))):
        tall, wide = ((66, 47), (47, 66), (46, 33), (33, 46))[rng.integers(4)]
        top, left = int(rng.integers(8, max(9, rows - tall - 8))), int(rng.integers(8, max(9, columns - wide - 8)))
        paper = board[top : top + tall, left : left + wide]
        paper[:] = papers[rng.integers(len(papers))]
        paper[4:10, 4 : wide // 2 + int(rng.integers(0, wide // 3))] = HUES[rng.integers(len(HUES))]
        for y in range(16, paper.shape[0] - 4, 5):
            paper[y : y + 2, 4 : wide - int(rng.integers(4, wide // 3))] = (120, 120, 122)
        cv2.circle(board, (left + wide // 2, top + 2), 3, (190, 40, 40), -1, cv2.LINE_AA)
    return framed(board, (120, 92, 60), 0.03)


def taped_note(rng: np.random.Generator) -> Pixels:
    """A sheet of paper taped to a door, 21 x 30 cm."""
    paper = sheet(0.21, 0.3, ((250, 248, 240), (250, 232, 130), (186, 216, 238))[rng.integers(3)])
    lettered(paper, str(rng.choice(TITLES)), (0.1, 0.1, 0.9, 0.26), HUES[rng.integers(len(HUES))])
    for y in range(26, 60, 7):
        paper[y : y + 2, 6 : 40 - int(rng.integers(0, 16))] = (110, 110, 112)
    return paper
