"""Text on drawings: any name can be written, told apart, and never wider than its room."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from worker.images import text

NAMES = (
    "gate",
    "Kühlraum Süd",
    "東京駅 丸の内口",
    "Ελλάδα",
    "Жук",
    "हिन्दी",
    "العربية",
    "bus 🚌",
    "a\u202eb\u200bc",
    "é" * 200,
)
needs_letters = pytest.mark.skipif(not hasattr(cv2, "FontFace"), reason="the fonts come with OpenCV 5")


@pytest.fixture
def only_pillows_font(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delattr(cv2, "FontFace", raising=False)
    text._is_wide.cache_clear()
    yield
    text._is_wide.cache_clear()


def written(name: str, size: int = 20, room: int = 400) -> np.ndarray:
    canvas = np.full((60, room + 100, 3), 255, np.uint8)
    text.write(canvas, text.fitted(name, size, room), (10, 40), size, (0, 0, 0))
    return canvas


def test_a_name_in_english_is_drawn_as_it_is() -> None:
    assert text.shown("Lab 3, ground floor (east) · 0.42") == "Lab 3, ground floor (east) · 0.42"
    assert (written("Lab 3") < 100).any()


@needs_letters
def test_letters_of_other_languages_are_drawn_as_they_are() -> None:
    for name in ("Kühlraum Süd", "東京駅", "Ελλάδα", "Жук", "العربية"):
        assert text.shown(name) == name
        assert (written(name) < 100).any()
    assert (written("東京駅") != written("大阪駅")).any()


@pytest.mark.usefixtures("only_pillows_font")
def test_without_a_font_that_has_them_they_are_visible_escapes() -> None:
    assert text.shown("Süd") == "S\\xfcd"
    assert text.shown("東京") == "\\u6771\\u4eac"
    assert (written("東京") != written("大阪")).any()


def test_what_no_font_has_and_what_would_be_invisible_is_escaped() -> None:
    assert text.shown("bus 🚌") == "bus \\U0001f68c"
    assert text.shown("a\u202eb\u200bc\nd") == "a\\u202eb\\u200bc\\nd"
    assert text.shown("\uffff") == "\\uffff"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("room", [0, 9, 60, 333])
def test_no_name_leaves_its_room(name: str, room: int) -> None:
    fitted = text.fitted(name, 16, room)
    assert text.width(fitted, 16) <= room

    canvas = written(name, 16, room)
    assert (canvas[:, : 10 - 2] == 255).all()
    assert (canvas[:, 10 + room + 2 :] == 255).all()


def test_names_that_differ_at_their_ends_stay_different() -> None:
    first, second = (text.fitted("corridor of the west wing, camera " * 5 + end, 16, 250) for end in ("0041", "0042"))
    assert first.endswith("0041")
    assert second.endswith("0042")
    assert text.MORE in first
    assert first.startswith("corridor")


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=80), st.integers(0, 300), st.integers(8, 30))
def test_any_text_fits(name: str, room: int, size: int) -> None:
    assert text.width(text.fitted(name, size, room), size) <= room
    assert all(text.width(line, size) <= room for line in text.wrapped(name, size, room, 3))


def test_lines_break_at_blanks_and_end_shortened() -> None:
    told = "cells agree less, 0.41 against 0.63; fewer keypoints fit, 4 against 62; " * 4

    lines = text.wrapped(told, 16, 300, 3)

    assert len(lines) == 3
    assert lines[0] == "cells agree less, 0.41 against 0.63; fewer"
    assert text.MORE in lines[-1]
    assert text.MORE not in "".join(lines[:-1])
    assert text.wrapped("one line", 16, 300, 3) == ["one line"]
    assert text.wrapped("", 16, 300, 3) == []


@pytest.mark.parametrize("at", [(-30, 20), (90, 20), (10, 2), (10, 70), (-900, -900), (900, 900)])
def test_what_lies_beyond_the_canvas_is_cut_off(at: tuple[int, int]) -> None:
    inside = np.full((200, 400, 3), 255, np.uint8)
    text.write(inside, "place 42", (at[0] + 100, at[1] + 50), 20, (0, 0, 0))
    canvas = np.full((50, 100, 3), 255, np.uint8)

    text.write(canvas, "place 42", at, 20, (0, 0, 0))

    if abs(at[0]) < 200:
        np.testing.assert_array_equal(canvas, inside[50:100, 100:200])
    else:
        assert (canvas == 255).all()
