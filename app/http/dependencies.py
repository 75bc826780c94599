"""Dependencies of the routes: the use-cases, the metrics, checked path and query parameters."""

from collections.abc import Awaitable
from typing import Annotated

from fastapi import Depends, Path, Query, Request

from app.http.body import refuse_body
from app.http.curate import Curator
from app.http.job_events import Followers
from app.http.keys import Accesses
from app.http.lifecycle import Lifecycle
from app.http.metrics import Metrics
from app.http.parameters import NoParameters
from app.http.recognise import Recogniser
from app.http.validation import OnceEach
from schemas.errors import NotFound
from schemas.keys import Access
from schemas.values import MAP_NAME


async def _recogniser(request: Request) -> Recogniser:
    recogniser: Recogniser = request.app.state.service.recogniser
    return recogniser


async def _curator(request: Request) -> Curator:
    curator: Curator = request.app.state.service.curator
    return curator


async def _lifecycle(request: Request) -> Lifecycle:
    lifecycle: Lifecycle = request.app.state.service.lifecycle
    return lifecycle


async def _followers(request: Request) -> Followers:
    followers: Followers = request.app.state.followers
    return followers


async def _metrics(request: Request) -> Metrics:
    metrics: Metrics = request.app.state.metrics
    return metrics


Recognises = Annotated[Recogniser, Depends(_recogniser)]
Curates = Annotated[Curator, Depends(_curator)]
Lifecycles = Annotated[Lifecycle, Depends(_lifecycle)]
Follows = Annotated[Followers, Depends(_followers)]
Measures = Annotated[Metrics, Depends(_metrics)]


MapName = Annotated[str, Path(alias="map", pattern=MAP_NAME, description="Name of the map.")]


async def _within(access: Access, kind: str, name: str, map_name: Awaitable[str]) -> str:
    """The id, for a caller that may use the map of what it names; to others it does not exist.

    The same answer whatever is the reason, so that nobody learns which ids there are in the maps of others.
    """
    try:
        allowed = access.may_use(await map_name)
    except NotFound:
        allowed = False
    if not allowed:
        raise NotFound(kind, name)
    return name


async def usable_view(view_id: str, access: Access, curator: Curator) -> str:
    """The id of a view; raises NotFound when it belongs to a map that the caller may not use."""

    async def map_name() -> str:
        return (await curator.view(view_id)).map

    return view_id if access.maps is None else await _within(access, "view", view_id, map_name())


async def _view_id(
    view_id: Annotated[str, Path(description="Id of the view.")], access: Accesses, curator: Curates
) -> str:
    return await usable_view(view_id, access, curator)


async def _job_id(
    job_id: Annotated[str, Path(description="Id of the job.")], access: Accesses, curator: Curates
) -> str:
    async def map_name() -> str:
        return (await curator.job(job_id)).map

    return job_id if access.maps is None else await _within(access, "job", job_id, map_name())


async def _query_id(
    query_id: Annotated[str, Path(description="Id of the query, from its answer.")], access: Accesses, curator: Curates
) -> str:
    async def map_name() -> str:
        """Of a query of several maps one that the caller may not use, if there is any."""
        names = await curator.maps_of_query(query_id)
        return next((name for name in names if not access.may_use(name)), names[0])

    return query_id if access.maps is None else await _within(access, "explained query", query_id, map_name())


async def _snapshot_id(
    snapshot_id: Annotated[str, Path(description="Id of the snapshot: that of its job.")],
    access: Accesses,
    curator: Curates,
) -> str:
    async def map_name() -> str:
        return (await curator.snapshot(snapshot_id)).map

    return snapshot_id if access.maps is None else await _within(access, "snapshot", snapshot_id, map_name())


ViewId = Annotated[str, Depends(_view_id)]
JobId = Annotated[str, Depends(_job_id)]
QueryId = Annotated[str, Depends(_query_id)]
SnapshotId = Annotated[str, Depends(_snapshot_id)]
"""Ids in paths; of views, jobs, queries and snapshots of maps that the caller may use."""


async def _once_each(_: Annotated[OnceEach, Query()]) -> None: ...


async def _no_parameters(_: Annotated[NoParameters, Query()]) -> None: ...


async def _documented_body(request: Request) -> None:
    if "requestBody" not in (request.scope["route"].openapi_extra or {}):
        await refuse_body(request)


checked = [Depends(_once_each), Depends(_documented_body)]
"""For routes whose parameters FastAPI reads: a repeated parameter is an error, and so is a body where the OpenAPI
document has none, instead of being ignored."""

no_parameters = Depends(_no_parameters)
"""For routes without parameters: an unknown parameter is an error instead of being ignored."""
