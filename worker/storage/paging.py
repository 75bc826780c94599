"""Cursors: opaque names of the place where a page ended."""

import base64
import json

from schemas.errors import InvalidParameters


def cursor_after(order: str, *last: str | int) -> str:
    """A cursor for the page after a row, known by what the rows are sorted by.

    Parameters
    ----------
    order : str
        Name of the order; the cursor is good for no other.
    """
    return base64.urlsafe_b64encode(json.dumps([order, *last]).encode()).decode().rstrip("=")


def read_cursor(order: str, cursor: str, *kinds: type[str] | type[int]) -> list[str | int]:
    """What `cursor_after` was given.

    Raises
    ------
    InvalidParameters
        The cursor is of another order, or none of ours.
    """
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        found: list[str | int] = json.loads(base64.urlsafe_b64decode(padded.encode("ascii")))
        if [type(value) for value in found] == [str, *kinds] and found[0] == order:
            return found[1:]
    except (ValueError, TypeError):
        pass
    raise InvalidParameters.of("cursor", f"{cursor[:80]!r} is no cursor of this listing; begin again without one")
