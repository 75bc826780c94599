"""The scope that each route asks of a key."""

from collections.abc import Mapping
from dataclasses import dataclass

from starlette.routing import compile_path

from app.console.files import files
from schemas.keys import Scope

OPEN_PATHS = frozenset({"/livez", "/readyz", "/version", *files()})
"""Paths that need no key: signs of life, and the files of the console."""

OF_ALL_MAPS = frozenset({"/metrics"})
"""Paths whose answers name every map: a key for some maps is not enough."""

COMPREFACE = "/compat/compreface/{map}/api/v1/recognition"

READ: tuple[tuple[str, str], ...] = (
    ("POST", "/query"),
    ("POST", "/localize/geopose"),
    ("POST", f"{COMPREFACE}/recognize"),
    ("POST", f"{COMPREFACE}/faces/{{view_id}}/verify"),
    ("GET", f"{COMPREFACE}/faces"),
    ("GET", f"{COMPREFACE}/faces/{{view_id}}/img"),
    ("GET", f"{COMPREFACE}/subjects"),
    ("GET", "/views"),
    ("GET", "/views/{view_id}"),
    ("GET", "/views/{view_id}/image"),
    ("GET", "/views/{view_id}/thumbnail"),
    ("GET", "/views/{view_id}/segmentation.png"),
    ("GET", "/views/{view_id}/graph.png"),
    ("GET", "/views/{view_id}/changes"),
    ("GET", "/views/{view_id}/changes.png"),
    ("GET", "/queries/{query_id}/explanation.png"),
    ("GET", "/queries/{query_id}/changes"),
    ("GET", "/queries/{query_id}/changes.png"),
    ("GET", "/maps"),
    ("GET", "/maps/{map}"),
    ("GET", "/maps/{map}/health"),
    ("GET", "/maps/{map}/dynamic"),
    ("GET", "/maps/{map}/unknown"),
    ("GET", "/maps/{map}/unknown/{place_id}/image"),
    ("GET", "/maps/{map}/proposals"),
    ("GET", "/maps/{map}/proposals/{proposal_id}/image"),
    ("GET", "/maps/{map}/shadow"),
    ("GET", "/places"),
    ("GET", "/jobs"),
    ("GET", "/jobs/{job_id}"),
    ("GET", "/jobs/{job_id}/events"),
    ("GET", "/metrics"),
    ("GET", "/docs"),
    ("GET", "/openapi.json"),
)
WRITE: tuple[tuple[str, str], ...] = (
    ("POST", "/enroll"),
    ("POST", f"{COMPREFACE}/faces"),
    ("DELETE", f"{COMPREFACE}/faces"),
    ("DELETE", f"{COMPREFACE}/faces/{{view_id}}"),
    ("POST", f"{COMPREFACE}/subjects"),
    ("PUT", f"{COMPREFACE}/subjects/{{subject}}"),
    ("DELETE", f"{COMPREFACE}/subjects/{{subject}}"),
    ("DELETE", f"{COMPREFACE}/subjects"),
    ("POST", "/maps/{map}/unknown/{place_id}"),
    ("DELETE", "/maps/{map}/unknown/{place_id}"),
    ("POST", "/maps/{map}/proposals/{proposal_id}"),
    ("DELETE", "/maps/{map}/proposals/{proposal_id}"),
    ("PATCH", "/views/{view_id}"),
    ("DELETE", "/views/{view_id}"),
    ("DELETE", "/views"),
    ("POST", "/maps/{map}/imports"),
    ("DELETE", "/jobs/{job_id}"),
)
ADMIN: tuple[tuple[str, str], ...] = (
    ("PUT", "/maps/{map}"),
    ("PATCH", "/maps/{map}"),
    ("DELETE", "/maps/{map}"),
    ("POST", "/maps/{map}/recipe"),
    ("POST", "/maps/{map}/shadow/switch"),
    ("DELETE", "/maps/{map}/shadow"),
    ("POST", "/maps/{map}/vocabulary"),
    ("POST", "/maps/{map}/calibration"),
    ("DELETE", "/maps/{map}/calibration"),
    ("POST", "/maps/{map}/snapshots"),
    ("GET", "/snapshots"),
    ("GET", "/snapshots/{snapshot_id}"),
    ("DELETE", "/snapshots/{snapshot_id}"),
    ("POST", "/restore"),
)

ROUTES: Mapping[tuple[str, str], Scope] = {
    **dict.fromkeys(READ, "read"),
    **dict.fromkeys(WRITE, "write"),
    **dict.fromkeys(ADMIN, "admin"),
}
"""Method and path to scope. HEAD counts as GET. A test holds the routes of the application against this table."""


@dataclass(frozen=True)
class Demand:
    """What a request asks of its key.

    Parameters
    ----------
    scope : Scope
    map_name : str or None
        The map that the path names.
    all_maps : bool
        Whether a key for some maps is not enough.
    """

    scope: Scope
    map_name: str | None = None
    all_maps: bool = False


# By Starlette's own expressions: a path must not mean one route here and another one there.
# The name of a subject may have slashes in it.
_COMPILED = [
    (method, path, compile_path(path.replace("{subject}", "{subject:path}"))[0], scope)
    for (method, path), scope in ROUTES.items()
]


def methods_of(path: str) -> set[str]:
    """The methods of all routes of an address, of those that ask for a key."""
    return {method for method, _, pattern, _ in _COMPILED if pattern.match(path)}


def demand(method: str, path: str) -> Demand:
    """What a request asks of its key; of a route that is in no table, the most."""
    method = "GET" if method == "HEAD" else method
    for of, template, pattern, scope in _COMPILED:
        if of == method and (match := pattern.match(path)):
            return Demand(scope, match.groupdict().get("map"), template in OF_ALL_MAPS)
    # An unknown address is answered 404 to whoever may read; a method that may change something is refused first.
    return Demand("read" if method in ("GET", "OPTIONS") else "admin")
