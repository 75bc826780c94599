"""Middleware that lets every address be asked for in the ways that HTTP libraries and people use."""

from urllib.parse import unquote_to_bytes

import anyio
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.refusing import refuse
from schemas.errors import InvalidParameters, NotFound, ParameterError

NO_MAP, DEFAULT_MAP = "/compat/compreface/api/", "/compat/compreface/default/api/"
"""Beginnings of addresses of a service that knows no maps, and what they mean here."""


NAMELESS = "the name or id behind the last slash is missing, or is `.` or `..`; nothing was deleted"


class Addresses:
    """HEAD is answered as GET without the body (RFC 9110, 9.3.2), ``/views/`` as ``/views``.

    `NO_MAP` is the map ``default``. (A map that is named ``api`` has that part twice.)

    A body that would be streamed is ended at once: HEAD of a snapshot reads no file, that of events does not last.

    Only a DELETE with a slash at its end is refused: what it names is missing, or was ``.`` or ``..``, of which clients
    make such addresses. ``/maps/campus/`` is what they make of ``/maps/campus/unknown/..``, and would delete the map.

    A slash is not answered with a redirect, for which a client would have to send its image again. Parameters that are
    not UTF-8 are refused: frameworks put other characters in the place of such bytes, and would keep a name so.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path: str = scope["path"]
        # A slash that was encoded belongs to a name: that of a place may end so.
        if len(path) > 1 and path.endswith("/") and scope.get("raw_path", b"/").endswith(b"/"):
            if scope["method"] == "DELETE":
                await refuse(NotFound("address", path, NAMELESS), scope, receive, send)
                return
            scope["path"] = path[:-1]
            scope["raw_path"] = scope.get("raw_path", b"").removesuffix(b"/")
        if path.startswith(NO_MAP) and not path.startswith(f"{NO_MAP}api/"):
            scope["path"] = DEFAULT_MAP + scope["path"].removeprefix(NO_MAP)
            scope["raw_path"] = DEFAULT_MAP.encode() + scope.get("raw_path", b"").removeprefix(NO_MAP.encode())
        if errors := _unreadable(scope["query_string"]):
            await refuse(InvalidParameters(errors), scope, receive, send)
            return
        if scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        # `Range` is of GET alone (RFC 9110, 14.2).
        inner = {**scope, "method": "GET", "headers": [one for one in scope["headers"] if one[0] != b"range"]}

        async def send_head(message: Message) -> None:
            if message["type"] != "http.response.body":
                await send(message)
            elif not streaming.cancel_called:
                await send({"type": "http.response.body"})
                if message.get("more_body", False):
                    streaming.cancel()

        try:
            with anyio.CancelScope() as streaming:
                await self._app(inner, receive, send_head)
        finally:
            scope.update({name: inner[name] for name in ("route", "path_params") if name in inner})  # for the log


def _unreadable(query: bytes) -> list[ParameterError]:
    """The parameters of a URL whose name or value is not UTF-8."""
    if query.isascii() and b"%" not in query:
        return []
    found = []
    for pair in query.split(b"&"):
        plain = unquote_to_bytes(pair.replace(b"+", b" "))
        try:
            plain.decode()
        except UnicodeDecodeError:
            name = plain.partition(b"=")[0].decode(errors="replace")
            found.append(ParameterError(name, "is not UTF-8; percent-encode it in UTF-8"))
    return found
