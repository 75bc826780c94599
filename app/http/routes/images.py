"""Images of a view: without metadata, small, segmentation, context graph; all with an ETag. Explanations of queries."""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from app.http.conditional import is_fresh, quoted
from app.http.dependencies import Curates, QueryId, ViewId, checked, no_parameters
from app.http.image_parameters import ExplanationParameters
from app.http.openapi import DRAWN_BY, answers_bytes, refusals
from app.http.parameters import (
    GraphParameters,
    SegmentationParameters,
    ThumbnailParameters,
)

router = APIRouter(tags=["images"], dependencies=checked)

TYPES = ("image/jpeg", "image/png", "image/webp", "image/bmp", "image/tiff")
_DRAWN = ("conflict", "too-many-requests")


def _responses(*types: str, description: str, drawn: bool = False) -> dict[int | str, dict[str, Any]]:
    return {
        **answers_bytes(*types, description=description, etag=True, drawn=drawn),
        **refusals("not-found", "image-not-kept", *(_DRAWN if drawn else ())),
    }


@router.get(
    "/views/{view_id}/image",
    response_class=Response,
    dependencies=[no_parameters],
    responses=_responses(
        *TYPES,
        description="The enrolled image: its pixels, orientation and colour profile, without EXIF, position, comments "
        "and whatever lies behind it. One that has none of these comes byte for byte. HEIC comes as JPEG, upright.",
    ),
)
async def image(view_id: ViewId, request: Request, curator: Curates) -> Response:
    """The image as it was enrolled, without its metadata."""
    etag = await curator.view_etag(view_id, "image-stripped")
    if is_fresh(request, etag):
        return _unchanged(etag)
    data, media_type = await curator.image(view_id)
    answer = _image(data, media_type, etag)
    extension = media_type.removeprefix("image/")
    answer.headers["Content-Disposition"] = f'inline; filename="{view_id}.{extension}"'
    return answer


@router.get(
    "/views/{view_id}/thumbnail",
    response_class=Response,
    responses=_responses("image/jpeg", description="The image, small and upright."),
)
async def thumbnail(
    view_id: ViewId,
    params: Annotated[ThumbnailParameters, Query()],
    request: Request,
    curator: Curates,
) -> Response:
    """A small JPEG of the image."""
    etag = await curator.view_etag(view_id, f"thumbnail-{params.size}")
    if is_fresh(request, etag):
        return _unchanged(etag)
    return _image(await curator.thumbnail(view_id, params.size), "image/jpeg", etag)


@router.get(
    "/views/{view_id}/segmentation.png",
    response_class=Response,
    responses=_responses(
        "image/png",
        description="Indexed PNG: each pixel is an index into the map's labels. With overlay, RGB. Both are as large "
        "as the image.",
        drawn=True,
    ),
)
async def segmentation(
    view_id: ViewId,
    params: Annotated[SegmentationParameters, Query()],
    request: Request,
    curator: Curates,
) -> Response:
    """The label of each pixel, at the finest grid the encoder offers; the method itself uses coarser cells."""
    kind = "overlay" if params.overlay else "segmentation"
    etag = await curator.view_etag(view_id, f"{kind}-legend" if params.legend else kind)
    if is_fresh(request, etag):
        return _unchanged(etag)
    drawn = await curator.segmentation(view_id, params.overlay, params.legend)
    return _image(drawn, "image/png", etag, curator.segmented_by())


@router.get(
    "/views/{view_id}/graph.png",
    response_class=Response,
    responses=_responses(
        "image/png",
        description="Nodes, labels and edges over the photo, as large as it is; without nodes of dynamic labels and "
        "of regions below 1 % of the image.",
        drawn=True,
    ),
)
async def graph(
    view_id: ViewId,
    params: Annotated[GraphParameters, Query()],
    request: Request,
    curator: Curates,
) -> Response:
    """The context graph that the method compares, drawn over the image."""
    etag = await curator.view_etag(view_id, "graph-legend" if params.legend else "graph")
    if is_fresh(request, etag):
        return _unchanged(etag)
    return _image(await curator.graph(view_id, params.legend), "image/png", etag, "encoder")


@router.get(
    "/queries/{query_id}/explanation.png",
    response_class=Response,
    responses={
        **answers_bytes(
            "image/png",
            description="The verdict; query, match and a rival side by side, with the cells, keypoints and regions "
            "that agree; the parts of the score; why the rival lost. 1600 pixels wide.",
        ),
        **refusals("not-found"),
    },
)
async def explanation(
    query_id: QueryId,
    params: Annotated[ExplanationParameters, Query()],
    curator: Curates,
) -> Response:
    """What decided about a query that was sent with `explain=true`; kept for a bounded time."""
    return Response(await curator.explanation(query_id, params.view), headers=_NO_STORE, media_type="image/png")


# Caches keep it but revalidate each time: a deleted view must not live on in a cache.
_CACHE = {"Cache-Control": "private, no-cache"}
_NO_STORE = {"Cache-Control": "private, no-store"}


def _unchanged(etag: str) -> Response:
    return Response(status_code=304, headers={"ETag": quoted(etag), **_CACHE})


def _image(data: bytes, media_type: str, etag: str, drawn_by: str | None = None) -> Response:
    named = {} if drawn_by is None else {DRAWN_BY: drawn_by}
    return Response(data, headers={"ETag": quoted(etag), **_CACHE, **named}, media_type=media_type)
