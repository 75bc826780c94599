"""What pages of other origins may do with the service: nothing, unless `REVISIT_CORS` names their origin."""

from collections.abc import Sequence

from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from app.http.idempotency import HEADER, REPLAYED
from app.http.openapi import DRAWN_BY
from app.http.problems import problem, request_id
from schemas.errors import echoed

METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
SENT = ("Authorization", "X-Api-Key", "Content-Type", HEADER, "If-None-Match", "If-Range", "Range", "X-Request-Id")
READ = (
    *("X-Request-Id", "Location", "Retry-After", "ETag", "Accept-Ranges", "Content-Range"),
    *("RateLimit", "RateLimit-Policy", REPLAYED, DRAWN_BY),
)
"""Headers that pages of these origins may send, and may read of answers, besides those that any may."""

PREFLIGHT_S = 600
"""Seconds for which a browser remembers what a preflight said."""


class Cors(CORSMiddleware):
    """Starlette's, but that it refuses a preflight by a problem as everything is refused."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        headers = Headers(scope=scope) if scope["type"] == "http" else Headers()
        if "origin" in headers and "access-control-request-method" in headers and scope["method"] == "OPTIONS":
            answer = self.preflight_response(headers)
            if answer.status_code >= 400:
                told = {name: value for name, value in answer.headers.items() if not name.startswith("content-")}
                answer = problem("other-site", self._why(headers), request_id(Request(scope)), headers=told)
            await answer(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)

    def _why(self, headers: Headers) -> str:
        """What of a preflight is refused."""
        origin, method = headers["origin"], headers["access-control-request-method"]
        sent = [one.strip() for one in headers.get("access-control-request-headers", "").split(",")]
        strange = [one for one in sent if one and one.lower() not in self.allow_headers]
        wrong = [
            "" if self.is_allowed_origin(origin) else f"REVISIT_CORS does not name the origin {echoed(origin)}",
            "" if method in METHODS else f"pages may not send {echoed(method)}",
            f"pages may not send the header {echoed(', '.join(strange))}" if strange else "",
        ]
        return "; ".join(filter(None, wrong)) or "pages may not send this"


def cors(app: ASGIApp, origins: Sequence[str]) -> CORSMiddleware:
    """Middleware that answers preflights without a key, as browsers send none, and names the origin in every answer.

    Cookies are never asked for: a key is a header that the page itself sends.
    """
    return Cors(
        app,
        allow_origins=origins,
        allow_methods=METHODS,
        allow_headers=SENT,
        expose_headers=READ,
        max_age=PREFLIGHT_S,
        allow_private_network=True,  # where the service mostly is; Chrome asks so before a public page calls there
    )
