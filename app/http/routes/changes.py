"""What changed at a place: between two views, or between a query and its first match."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from app.http.conditional import is_fresh, quoted
from app.http.dependencies import Curates, QueryId, ViewId, checked, no_parameters, usable_view
from app.http.image_parameters import ChangesParameters
from app.http.keys import Accesses
from app.http.openapi import answers_bytes, refusals
from schemas.wire import Changes

router = APIRouter(tags=["images"], dependencies=checked)

_DRAWN = "The earlier photo beside the later one, with what is gone, new and moved outlined. 1280 pixels wide."
_REFUSED = refusals("not-found", "image-not-kept", "conflict", "too-many-requests")


@router.get("/views/{view_id}/changes", response_model=Changes, responses=_REFUSED)
async def changes(
    view_id: ViewId, params: Annotated[ChangesParameters, Query()], curator: Curates, access: Accesses
) -> Changes:
    """What is gone, new or moved since an earlier view of the same place."""
    await usable_view(params.since, access, curator)
    return await curator.changes(view_id, params.since)


@router.get(
    "/views/{view_id}/changes.png",
    response_class=Response,
    responses={**answers_bytes("image/png", description=_DRAWN, etag=True), **_REFUSED},
)
async def draw_changes(
    view_id: ViewId,
    params: Annotated[ChangesParameters, Query()],
    request: Request,
    curator: Curates,
    access: Accesses,
) -> Response:
    """Both views, with what changed outlined."""
    await usable_view(params.since, access, curator)
    etag = await curator.changes_version(view_id, params.since)
    headers = {"ETag": quoted(etag), "Cache-Control": "private, no-cache"}
    if is_fresh(request, etag):
        return Response(status_code=304, headers=headers)
    return Response(await curator.draw_changes(view_id, params.since), headers=headers, media_type="image/png")


@router.get("/queries/{query_id}/changes", response_model=Changes, responses=_REFUSED, dependencies=[no_parameters])
async def changes_of_query(query_id: QueryId, curator: Curates) -> Changes:
    """What changed from the first match of a query sent with `explain=true` to its photo, as `changes=true` says it."""
    return await curator.changes_of_query(query_id)


@router.get(
    "/queries/{query_id}/changes.png",
    response_class=Response,
    dependencies=[no_parameters],
    responses={**answers_bytes("image/png", description=_DRAWN), **_REFUSED},
)
async def draw_changes_of_query(query_id: QueryId, curator: Curates) -> Response:
    """The first match of a query sent with `changes=true` or `explain=true`, and its photo, with what changed."""
    headers = {"Cache-Control": "private, no-store"}
    return Response(await curator.draw_changes_of_query(query_id), headers=headers, media_type="image/png")
