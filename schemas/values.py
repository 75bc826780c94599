"""Parsers of single parameters: times, filters, metadata. Each raises ValueError saying what is wrong."""

import json
import math
import re
import unicodedata
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

MAP_NAME = "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
SOME_ID = "^[A-Za-z0-9-]{1,64}$"
PATTERNS_IN_WORDS = {
    MAP_NAME: "needs 1 to 64 of A-Z, a-z, 0-9, dot, _ and -, the first a letter or digit",
    SOME_ID: "needs 1 to 64 of A-Z, a-z, 0-9 and -",
}
MOST_MAPS = 16
"""Maps of one query."""

METADATA_BYTES = 16 * 1024
METADATA_DEPTH = 8

MOST_DIGITS = 4300
"""Of a whole number in JSON: more are not read, as they take long."""

FARTHEST_M = 1e9
"""Metres from the origin of a map's frame: beyond, distances would be of numbers that are not what was meant."""

LEAST_STEP = 0.01
"""Seconds or metres from one image of an import to the next."""

LARGEST_ZOOM = 4.0
"""Zooms of queries are from the inverse of this to this: beyond it hardly anything is left to compare."""

LONGEST_FILE_NAME = 255
_LONGEST_ENDING = 10
_BLANK = frozenset("\u115f\u1160\u2800\u3164\uffa0")  # letters and symbols that show nothing
_DIRECTIONS = frozenset("\u200e\u200f\u061c\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")

_RFC3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)")
_NUMBERS = re.compile(r"(\d+)(?:\.(\d+))?", re.ASCII)
_LOST_PLUS = re.compile(r".*[\d.] \d\d:\d\d")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]|[\ud800-\udfff]")
_LONGEST_S = 1_000_000_000


def moment(text: object) -> datetime:
    """Parse an RFC 3339 time with its zone; returns it in UTC."""
    if isinstance(text, datetime):
        return text
    if not isinstance(text, str) or not _RFC3339.fullmatch(text):
        hint = "; in a URL, write + as %2B" if isinstance(text, str) and _LOST_PLUS.fullmatch(text) else ""
        raise ValueError(f"needs an RFC 3339 time with its zone, such as 2026-03-01T09:30:00Z{hint}")
    try:
        return datetime.fromisoformat(text.upper()).astimezone(UTC)
    except (ValueError, OverflowError):
        raise ValueError("is not a valid date and time") from None


def plain_text(text: object) -> str:
    """Check text: not blank, no control characters, no half of a surrogate pair."""
    if not isinstance(text, str):
        raise ValueError("needs text")
    if not text.strip():
        raise ValueError("must not be empty")
    if any(ord(c) < 32 or 0xD800 <= ord(c) <= 0xDFFF or ord(c) == 127 for c in text):
        raise ValueError("must not contain control characters")
    return text


def place_name(text: object) -> str:
    """Check the name of a place as it is given: text of which something is seen, without commands to a terminal.

    Returned as `composed`: one name is one place, whichever program wrote it.
    """
    checked = composed(plain_text(text))
    categories = [unicodedata.category(c) for c in checked]
    if "Cc" in categories:
        raise ValueError("must not contain control characters")
    if all(kind == "Cf" or kind[0] in "MZ" or c in _BLANK for c, kind in zip(checked, categories, strict=True)):
        raise ValueError("must have a character that is seen")
    return checked


def file_name(text: str | None) -> str | None:
    """The last part of a file name as it was sent, without control characters, at most `LONGEST_FILE_NAME` of it.

    Browsers and tools send what they like, folders included; a name is of use to people alone, so that it is cleaned
    and never refused. None: nothing is left.
    """
    last = re.split(r"[/\\]", text or "")[-1]
    # What turns the direction of writing makes one name look like another.
    shown = "".join(c for c in last if unicodedata.category(c) not in ("Cc", "Cs") and c not in _DIRECTIONS).strip()
    if len(shown) > LONGEST_FILE_NAME:
        stem, dot, ending = shown.rpartition(".")
        ending = dot + ending if stem and len(ending) <= _LONGEST_ENDING else ""
        shown = shown[: LONGEST_FILE_NAME - len(ending) - 1] + "…" + ending
    return shown if shown.strip(".") else None


def composed(name: str) -> str:
    """A name with its accents in one character each (NFC), however the system that wrote it keeps them."""
    return unicodedata.normalize("NFC", name)


def spellings(name: str) -> tuple[str, ...]:
    """What a name may be kept as: composed, or as it was given before names were."""
    return tuple(sorted({name, composed(name), unicodedata.normalize("NFD", name)}))


def in_order(name: str) -> tuple[object, ...]:
    """A key that sorts file names as people count: ``9.jpg`` before ``10.jpg``, and ``0.25.jpg`` before ``0.5.jpg``."""
    parts = _NUMBERS.split(name)  # text, whole number, its decimals or None, text, ...
    return tuple(int(part) if at % 3 == 1 else part or "" for at, part in enumerate(parts)), name


def whole_turn(degrees: float) -> float:
    """360 degrees as 0; what is left of next to nothing below 0 by ``% 360`` is 360 too."""
    return 0.0 if degrees == 360 else degrees


def near(text: object) -> tuple[float, float, float]:
    """Parse ``x,y,radius`` or ``lat,lon,radius``; the radius in metres."""
    parts = str(text).split(",")
    try:
        first, second, radius = (float(part) for part in parts)
    except ValueError:
        raise ValueError("needs three numbers: x,y,radius, or lat,lon,radius") from None
    if not all(map(math.isfinite, (first, second, radius))):
        raise ValueError("needs finite numbers")
    if radius <= 0:
        raise ValueError("needs a radius above 0 metres")
    if max(abs(first), abs(second)) > FARTHEST_M:
        raise ValueError(f"needs x and y within ±{FARTHEST_M:g} metres, as positions are")
    return first, second, min(radius, 10 * FARTHEST_M)  # which is all there can be: PostgreSQL cannot square any number


def exclude_last(text: object) -> int | timedelta:
    """Parse ``N`` views, or seconds as ``30s``."""
    if match := re.fullmatch(r"(\d{1,10})", str(text), re.ASCII):
        count = int(match[1])
        if count <= _LONGEST_S:
            return count
    elif match := re.fullmatch(r"(\d{1,10}(?:\.\d{1,6})?)s", str(text), re.ASCII):
        seconds = float(match[1])
        if seconds <= _LONGEST_S:
            return timedelta(seconds=seconds)
    raise ValueError(f"needs a number of views such as 10, or seconds such as 30s, at most {_LONGEST_S}")


def every(text: object) -> tuple[float, str]:
    """Parse a step as ``2s``, ``1min`` or ``0.5m``: seconds and ``s``, or metres and ``m``."""
    if match := re.fullmatch(r"(\d{1,6}(?:\.\d{1,3})?)(s|min|m)", str(text), re.ASCII):
        amount = float(match[1]) * (60 if match[2] == "min" else 1)
        if LEAST_STEP <= amount <= _LONGEST_S:
            return amount, "m" if match[2] == "m" else "s"
    raise ValueError(f"needs seconds such as 2s, minutes such as 1min or metres such as 1m, at least {LEAST_STEP}")


def identifiers(text: object) -> tuple[str, ...]:
    """Parse view ids with commas between them."""
    ids = tuple(part.strip() for part in str(text).split(","))
    if not all(re.fullmatch(SOME_ID, i) for i in ids):
        raise ValueError("needs view ids with commas between them")
    return ids


def map_names(text: object) -> tuple[str, ...]:
    """Parse names of maps with commas between them, each once."""
    names = tuple(part.strip() for part in str(text).split(","))
    if not all(re.fullmatch(MAP_NAME, name) for name in names):
        raise ValueError("needs names of maps with commas between them")
    if len(set(names)) < len(names):
        raise ValueError("names a map twice")
    if len(names) > MOST_MAPS:
        raise ValueError(f"needs at most {MOST_MAPS} maps, not {len(names)}")
    return names


def metadata(value: object) -> dict[str, Any]:
    """Check metadata: a JSON object, as text or parsed."""
    if isinstance(value, str):
        if len(value.encode("utf-8", "surrogatepass")) > METADATA_BYTES:
            raise ValueError(f"must not be longer than {METADATA_BYTES} bytes")
        value = strict_json(value)
    return metadata_object(value)


def metadata_object(value: object) -> dict[str, Any]:
    """Check metadata that is part of a JSON document: text with an object in it is none."""
    if not isinstance(value, dict):
        raise ValueError("needs a JSON object")
    check_metadata(value)
    return value


def check_metadata(value: dict[str, Any]) -> None:
    """Raise ValueError when parsed JSON is nested too deeply, too long, or has text that no database keeps."""
    if not within_depth(value, METADATA_DEPTH):
        raise ValueError(f"must not be nested deeper than {METADATA_DEPTH} levels")
    try:
        size = len(json.dumps(value, ensure_ascii=False).encode())
    except UnicodeEncodeError:
        raise ValueError("contains half of a surrogate pair") from None
    if size > METADATA_BYTES:
        raise ValueError(f"must not be longer than {METADATA_BYTES} bytes")
    # PostgreSQL's jsonb cannot keep it; what is valid must not depend on the store.
    if any("\0" in part for part in _texts(value)):
        raise ValueError("must not contain the character U+0000")


def strict_json(text: str | bytes) -> Any:
    """Parse JSON as in RFC 8259: no NaN, no number beyond float64, no name twice in an object, whole characters.

    Half of a surrogate pair, which an escape can write and no encoding has, could be neither kept nor shown again.
    """
    try:
        whole = text if isinstance(text, str) else text.decode(json.detect_encoding(text))
        value = json.loads(
            whole, parse_constant=_no_constant, parse_float=_finite, parse_int=_whole_number, object_pairs_hook=_unique
        )
        if _SURROGATE.search(whole) and not all(map(_is_unicode, _texts(value))):
            raise ValueError("contains half of a surrogate pair")
        return value
    except json.JSONDecodeError as error:
        raise ValueError(f"is not JSON: {error.msg} at character {error.pos}") from None
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    except UnicodeDecodeError:
        raise ValueError("is not UTF-8") from None


def _no_constant(name: str) -> float:
    raise ValueError(f"contains {name}, which is not JSON")


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"contains the number {text[:40]}, which is too large")
    return number


def _whole_number(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"contains the number {text[:40]}… of {len(text)} digits; at most {MOST_DIGITS} are taken")
    return int(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    whole: dict[str, Any] = {}
    for name, value in pairs:
        if name in whole:
            raise ValueError(f"has the name {name!r} twice")
        whole[name] = value
    return whole


def within_depth(value: object, levels: int) -> bool:
    """Whether objects and lists are nested at most `levels` deep; recurses no deeper than that."""
    if isinstance(value, dict):
        return levels > 0 and all(within_depth(inner, levels - 1) for inner in value.values())
    if isinstance(value, list):
        return levels > 0 and all(within_depth(inner, levels - 1) for inner in value)
    return True


def _is_unicode(text: str) -> bool:
    return not any("\ud800" <= c <= "\udfff" for c in text)


def _texts(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from value
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)
