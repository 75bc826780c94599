"""The drawing of what changed: outlines where things are, and nothing leaves the sheet."""

import cv2
import numpy as np
import pytest

from worker.images.changes import TINTS, WIDTH, Mark, Side, changes_png
from worker.images.drawing import Pixels

GREY = np.full((300, 400, 3), 128, np.uint8)
HIGH = np.full((400, 120, 3), 128, np.uint8)


def cells(rows: slice, columns: slice) -> np.ndarray:
    mask = np.zeros((30, 40), np.bool_)
    mask[rows, columns] = True
    return mask


def drawn(then: Side, now: Side, told: str = "") -> Pixels:
    read = cv2.imdecode(np.frombuffer(changes_png(then, now, told), np.uint8), cv2.IMREAD_COLOR_RGB)
    return np.asarray(read, np.uint8)


def share(pixels: Pixels, kind: str) -> float:
    """Share of pixels of the colour of a kind of change."""
    return float((np.abs(pixels.astype(int) - TINTS[kind]) < 12).all(axis=-1).mean())


def test_what_is_gone_is_outlined_in_the_earlier_photo_and_what_is_new_in_the_later() -> None:
    gone, new = (Mark(kind, f"chair {kind}", cells(slice(10, 20), slice(10, 20))) for kind in ("gone", "new"))
    sheet = drawn(Side(GREY, "then: hall", [gone]), Side(GREY, "now: query", [new]))

    assert sheet.shape[1] == WIDTH
    photos = sheet[44 : 44 + 440]
    left, right = photos[:, : WIDTH // 2], photos[:, WIDTH // 2 :]
    assert share(left, "gone") > 0.005
    assert share(left, "new") == 0
    assert share(right, "new") > 0.005
    assert share(right, "gone") == 0


@pytest.mark.parametrize("text", ["", "one thing gone", "much is gone " * 200, "東京駅" * 60])
@pytest.mark.parametrize("pixels", [GREY, HIGH, GREY[:1, :1]])
def test_any_photo_and_any_text_fit(pixels: Pixels, text: str) -> None:
    whole = Mark("moved", text, np.ones((30, 40), np.bool_))
    sheet = drawn(Side(pixels, text, [whole]), Side(GREY, text), text)

    assert sheet.shape[1] == WIDTH
