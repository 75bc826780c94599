"""What pages of other origins may do with the service: nothing, unless `REVISIT_CORS` names their origin."""

from collections.abc import Sequence

from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp

from app.http.idempotency import HEADER, REPLAYED
from app.http.openapi import DRAWN_BY

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
SENT = ("Authorization", "X-Api-Key", "Content-Type", HEADER, "If-None-Match", "X-Request-Id")
READ = ("X-Request-Id", "Location", "Retry-After", "ETag", "RateLimit", "RateLimit-Policy", REPLAYED, DRAWN_BY)
"""Headers that pages of these origins may send, and may read of answers, besides those that any may."""

PREFLIGHT_S = 600
"""Seconds for which a browser remembers what a preflight said."""


def cors(app: ASGIApp, origins: Sequence[str]) -> CORSMiddleware:
    """Middleware that answers preflights without a key, as browsers send none, and names the origin in every answer.

    Cookies are never asked for: a key is a header that the page itself sends.
    """
    return CORSMiddleware(
        app,
        allow_origins=origins,
        allow_methods=METHODS,
        allow_headers=SENT,
        expose_headers=READ,
        max_age=PREFLIGHT_S,
    )
