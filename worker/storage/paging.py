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
        if [type(value) for value in found] == [str, *kinds] and found[0] == order:
            return found[1:]
    except (ValueError, TypeError):
        pass
    raise InvalidParameters.of("cursor", f"{cursor[:80]!r} is no cursor of this listing; begin again without one")
