"""Text on drawings, by fonts that come with the packages: no system fonts.

Pillow embeds a font with the letters of English. Text in other letters is drawn by the fonts that OpenCV embeds from
version 5 on. A character in neither is drawn as its escape, such as ``\\u0905``, so that it can be told from others.
"""

import unicodedata
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from PIL import ImageFont

from worker.images.palette import Colour

Pixels = npt.NDArray[np.uint8]

MORE = "…"
"""Stands for what was left out."""

_NO_CHARACTER = "\uffff"
_FACE, _WEIGHT = "sans", 400


def shown(text: str) -> str:
    """The text as it is drawn: characters without a glyph, and those that would be invisible, as escapes."""
    return "".join(c if _is_plain(c) or _is_wide(c) else c.encode("unicode_escape").decode() for c in text)


def width(text: str, size: int) -> int:
    """Width in pixels of a text from `shown`, at a font size in pixels."""
    if all(map(_is_plain, text)):
        return int(np.ceil(_font(size).getlength(text)))
    left, _, wide, _ = cv2.getTextSize((1, 1), text, (0, 0), cv2.FontFace(_FACE), size, _WEIGHT)
    return int(left + wide)


def fitted(text: str, size: int, room: int) -> str:
    """The text as shown, its middle left out where it is wider than `room` pixels; empty where nothing fits.

    Names that differ only at their ends stay different.
    """
    text = shown(text)
    if width(text, size) <= room:
        return text
    fits, too_many = -1, len(text)
    while too_many - fits > 1:
        kept = (fits + too_many) // 2
        fits, too_many = (kept, too_many) if width(_shortened(text, kept), size) <= room else (fits, kept)
    return _shortened(text, fits) if fits >= 0 else ""


def wrapped(text: str, size: int, room: int, lines: int) -> list[str]:
    """The text in at most `lines` lines of at most `room` pixels, broken at blanks; what is too long is shortened."""
    found: list[str] = []
    words = shown(text).split()
    while words and len(found) < lines - 1:
        count = 1
        while count < len(words) and width(" ".join(words[: count + 1]), size) <= room:
            count += 1
        found.append(fitted(" ".join(words[:count]), size, room))
        words = words[count:]
    return [*found, fitted(" ".join(words), size, room)] if words else found


def write(canvas: Pixels, text: str, at: tuple[int, int], size: int, colour: Colour) -> None:
    """Draw a text from `shown` or `fitted`.

    Parameters
    ----------
    canvas : uint8 of shape (height, width, 3)
        RGB, changed in place; what lies beyond it is cut off.
    text : str
    at : (int, int)
        (x, y) of the left end of the baseline, in pixels.
    size : int
        Of the font, in pixels.
    colour : Colour
    """
    if not all(map(_is_plain, text)):
        cv2.putText(canvas, text, at, colour, cv2.FontFace(_FACE), size, _WEIGHT)
        return
    mask, (right, down) = _font(size).getmask2(text, "L", anchor="ls")
    wide, high = mask.size
    left, top = int(at[0] + right), int(at[1] + down)
    x, y = max(left, 0), max(top, 0)
    part = canvas[y : max(top + high, 0), x : max(left + wide, 0)]
    if part.size == 0:
        return
    inked = np.frombuffer(bytes(mask), np.uint8).reshape(high, wide)[y - top :, x - left :]
    cover = inked[: part.shape[0], : part.shape[1], None].astype(np.float32) / 255
    part[:] = np.rint(part * (1 - cover) + np.array(colour, np.float32) * cover).astype(np.uint8)


def widest(texts: Sequence[str], size: int) -> int:
    """Width in pixels of the widest of some texts; 0 for none."""
    return max((width(text, size) for text in texts), default=0)


def _shortened(text: str, kept: int) -> str:
    """The first and last characters, `kept` in all, with `MORE` between."""
    return text[: (kept + 1) // 2] + MORE + text[len(text) - kept // 2 :]


@lru_cache(maxsize=32)
def _font(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise RuntimeError("Pillow was built without FreeType")
    return font


@lru_cache(maxsize=4096)
def _is_plain(character: str) -> bool:
    """Whether the font that Pillow embeds has a character."""
    if character == " ":
        return True
    glyph, none = (_font(16).getmask(c) for c in (character, _NO_CHARACTER))
    return bool(glyph.size[0] and (glyph.size, bytes(glyph)) != (none.size, bytes(none)))


@lru_cache(maxsize=4096)
def _is_wide(character: str) -> bool:
    """Whether the fonts that OpenCV embeds have a character; they draw ``?`` for those they lack."""
    if not hasattr(cv2, "FontFace") or unicodedata.category(character)[0] in "CZ":
        return False
    glyph, none = (_glyph(c) for c in (character, "?"))
    return bool(glyph.any() and (glyph != none).any())


def _glyph(character: str) -> Pixels:
    canvas = np.zeros((48, 64, 3), np.uint8)
    cv2.putText(canvas, character, (12, 32), (255, 255, 255), cv2.FontFace(_FACE), 16)
    return canvas
