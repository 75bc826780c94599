"""Cursors: opaque text that says where a page of a listing ended."""

import base64
import json

from schemas.errors import InvalidParameters


def cursor_after(order: str, *last: str | int) -> str:
    """The cursor of the page after a row.

    Parameters
    ----------
    order : str
        Name of the listing's order; the cursor is valid for no other.
    last : str or int
        Sort key of the row.
    """
    return base64.urlsafe_b64encode(json.dumps([order, *last]).encode()).decode().rstrip("=")


def read_cursor(order: str, cursor: str, *kinds: type[str] | type[int]) -> list[str | int]:
    """The sort key in a cursor from `cursor_after`, of the types `kinds`.

    Raises
    ------
    InvalidParameters
        The cursor is of another order, or invalid.
    """
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        found: list[str | int] = json.loads(base64.urlsafe_b64decode(padded.encode("ascii")))
        if [type(value) for value in found] == [str, *kinds] and found[0] == order and all(map(_is_stored, found[1:])):
            return found[1:]
    except (ValueError, TypeError):
        pass
    raise InvalidParameters.of("cursor", f"{cursor[:80]!r} is no cursor of this listing; begin again without one")


def _is_stored(value: str | int) -> bool:
    """Whether a database may have a value: integers of 64 bits, and text without U+0000 and halves of characters."""
    if isinstance(value, int):
        return -(2**63) <= value < 2**63
    return not any(c == "\0" or "\ud800" <= c <= "\udfff" for c in value)
