"""Middleware that keeps pages of other sites, open in a browser on this machine, from using a service without keys.

A key is a header that no browser sends by itself, so a service with keys needs none of this. Without one, any page
could post to the loopback address (cross-site request forgery), and one whose name is pointed there could read the
answers too (DNS rebinding).
"""

import ipaddress
from collections.abc import Sequence
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.http.refusing import refuse
from app.http.scopes import OPEN_PATHS
from schemas.errors import OtherSite
from schemas.keys import ANONYMOUS, UNRESTRICTED

READING = frozenset({"GET", "HEAD", "OPTIONS"})
"""Methods that change nothing; pages of other sites cannot read what they answer."""


PRIVATE = (".localhost", ".local", ".internal", ".home.arpa")
"""Ends of names that the public domain name system does not have (RFC 6761, RFC 6762, RFC 8375)."""


class OtherSites:
    """Answers 403 `other-site`. Inside `KeyGate`, which says who calls.

    Parameters
    ----------
    app : ASGIApp
    origins : sequence of str
        Origins whose pages may call; ``*``: any.
    any_name : bool
        Whether the service may be called by any name: it is meant for whoever can reach it.
    """

    def __init__(self, app: ASGIApp, origins: Sequence[str], *, any_name: bool) -> None:
        self._app, self._origins, self._any_name = app, frozenset(origins), any_name

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it before its body is read."""
        if scope["type"] == "http" and scope["state"]["access"] is UNRESTRICTED:
            headers = Headers(scope=scope)
            error = self._misnamed(headers) or self._foreign(headers, scope["method"])
            if error is not None and scope["path"] in OPEN_PATHS:
                scope["state"]["access"] = ANONYMOUS  # no map is named to it either
            elif error is not None:
                await refuse(error, scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _misnamed(self, headers: Headers) -> OtherSite | None:
        """The error of a request for a name that anybody may point to this machine."""
        name = _name(headers.get("host", ""))
        if self._any_name or is_own(name):
            return None
        return OtherSite(
            f"a service without keys is not called by the name {name[:100]!r}, which may be anybody's: call it by "
            "localhost or by its address, make a key, or set REVISIT_OPEN=1 if a proxy decides who may call"
        )

    def _foreign(self, headers: Headers, method: str) -> OtherSite | None:
        """The error of a request that a page of another origin makes and that changes something."""
        origin, fetched = headers.get("origin"), headers.get("sec-fetch-site")
        if method in READING or "*" in self._origins or origin in self._origins:
            return None
        if fetched is not None:  # Fetch Metadata, which pages cannot set
            foreign = fetched not in ("same-origin", "none")
        else:  # RFC 6454, 7; older browsers
            foreign = origin is not None and urlsplit(origin).netloc != headers.get("host", "")
        if not foreign:
            return None
        return OtherSite(
            f"a page of {(origin or 'another site')[:100]} sent this, and pages of other sites may not write to a "
            "service without keys; name its origin in REVISIT_CORS, or send a key"
        )


def is_own(name: str) -> bool:
    """Whether a name of a host is none that the public domain name system could point here.

    An address, one word, such as ``localhost`` and the names of containers, or one of a private network.
    """
    if "." not in name.rstrip(".") or name.rstrip(".").endswith(PRIVATE):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _name(host: str) -> str:
    """The name in a ``Host`` header, without its port."""
    return host[1 : host.find("]")] if host.startswith("[") else host.partition(":")[0].lower()
