"""Conditional requests: whether the caller's copy is still current."""

from fastapi import Request


def quoted(etag: str) -> str:
    """An ETag as headers have it."""
    return etag if etag.endswith('"') else f'"{etag}"'


def is_fresh(request: Request, etag: str) -> bool:
    """Whether If-None-Match names this ETag, by weak comparison (RFC 9110, 13.1.2)."""
    given = ",".join(request.headers.getlist("if-none-match"))
    tags = [tag.strip().removeprefix("W/") for tag in given.split(",")]
    return "*" in tags or quoted(etag) in tags
