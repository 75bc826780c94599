"""Parts of a body by `Range` (RFC 9110, section 14), so that a download goes on where its connection broke."""

import re

from fastapi import Request

from app.http.conditional import quoted
from schemas.errors import RangeOutside

_ONE = re.compile(r"bytes=([0-9]{0,19})-([0-9]{0,19})", re.IGNORECASE)


def wanted(request: Request, size: int, etag: str) -> range | None:
    """The bytes that a request wants; None for all of them.

    All of them also where it names several parts, in a way that is not understood, or of another body than the one
    that `If-Range` names: each of that is allowed, and the caller sees it by the status.

    Parameters
    ----------
    request : Request
    size : int
        Bytes of the whole body.
    etag : str
        Of the body.

    Raises
    ------
    RangeOutside
        The body has none of these bytes.
    """
    given = _ONE.fullmatch(",".join(request.headers.getlist("range")).strip())
    if given is None or request.headers.get("if-range", quoted(etag)) != quoted(etag):
        return None
    first, last = given.groups()
    if first and last and int(last) < int(first):
        return None
    if first:
        part = range(int(first), min(int(last or size), size - 1) + 1)
    elif last:
        part = range(max(0, size - int(last)), size)
    else:
        return None
    if not part:
        raise RangeOutside(size)
    return part
