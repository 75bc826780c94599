"""`/maps/{map}/unknown`: queries that matched nothing, by spot: listed, named, dismissed."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from app.http.body import json_object
from app.http.dependencies import Curates, MapName, checked, no_parameters
from app.http.openapi import answers_bytes, refusals, takes_json
from app.http.parameters import AttributesDocument, UnknownParameters
from app.http.routes.views import in_document
from app.http.validation import validated
from schemas.errors import InvalidParameters
from schemas.requests import PostUnknown
from schemas.wire import DismissedPlace, NamedPlace, UnknownPlaces

router = APIRouter(tags=["maps"], dependencies=checked)

PlaceId = Annotated[str, Path(description="Id of the unknown place, from the list.")]


@router.get("/maps/{map}/unknown", response_model=UnknownPlaces, responses=refusals("not-found"))
async def list_unknown(name: MapName, params: Annotated[UnknownParameters, Query()], curator: Curates) -> UnknownPlaces:
    """Queries that matched nothing, by spot. They are kept where the map's `keep_queries` is above 0."""
    return await curator.unknown(name, params.limit)


@router.get(
    "/maps/{map}/unknown/{place_id}/image",
    response_class=Response,
    dependencies=[no_parameters],
    responses={**answers_bytes("image/jpeg", description="The image, small and upright."), **refusals("not-found")},
)
async def unknown_image(
    name: MapName,
    place_id: Annotated[str, Path(description="Id of an unknown place, or of any of its queries.")],
    curator: Curates,
) -> Response:
    """A small image of a query that matched nothing."""
    return Response(await curator.kept_image(name, place_id), media_type="image/jpeg")


@router.post(
    "/maps/{map}/unknown/{place_id}",
    response_model=NamedPlace,
    dependencies=[no_parameters],
    openapi_extra=takes_json(
        {"$ref": "#/components/schemas/PostUnknown"},
        required=True,
        example={"place": "loading dock", "position": {"x": 12.5, "y": 3.0}},
    ),
    responses=refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full", "too-many-requests"),
)
async def name_unknown(name: MapName, place_id: PlaceId, request: Request, curator: Curates) -> NamedPlace:
    """Name an unknown place: up to 10 of its images are enrolled as views of it, and its queries leave the list."""
    wanted = validated(PostUnknown, await json_object(request), strict=True)
    where = {} if wanted.position is None else wanted.position.model_dump(exclude_none=True)
    try:
        document = validated(AttributesDocument, {"place": wanted.place, **where})
    except InvalidParameters as error:
        raise InvalidParameters([in_document(one) for one in error.errors]) from None
    return await curator.name_unknown(name, place_id, document.attributes())


@router.delete(
    "/maps/{map}/unknown/{place_id}",
    response_model=DismissedPlace,
    dependencies=[no_parameters],
    responses=refusals("not-found"),
)
async def dismiss_unknown(name: MapName, place_id: PlaceId, curator: Curates) -> DismissedPlace:
    """Delete the queries of an unknown place, and their images."""
    return await curator.dismiss_unknown(name, place_id)
