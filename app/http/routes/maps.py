"""`/maps`: make, show, change, re-describe and delete maps."""

from typing import Annotated, TypeVar

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from app.http.body import LARGEST_JSON, json_object
from app.http.dependencies import Curates, MapName, checked, no_parameters
from app.http.examples import CALIBRATION_REPORT, POST_CALIBRATION
from app.http.keys import Accesses
from app.http.openapi import refusals, takes_json, takes_map
from app.http.snapshot_presenters import allowed
from app.http.started import STARTED, started
from app.http.validation import Parameters, validated
from schemas.errors import InvalidParameters
from schemas.requests import PatchMap, PostCalibration, PostRecipe, PutMap
from schemas.wire import CalibrationReport, Deleted, DynamicPreview, Job, MapFacts, Maps

M = TypeVar("M", bound=BaseModel)

previews = APIRouter(tags=["maps"], dependencies=checked)
router = APIRouter(tags=["maps"], dependencies=[*checked, no_parameters])

MOST_LABELS = 2 * 1024 * 1024
"""Bytes of the largest body with labelled queries: 5,000 take some 500 kB."""


class PreviewParameters(Parameters):
    """Parameters of `GET /maps/{map}/dynamic`."""

    dynamic: str = Field(
        max_length=2000, description="Labels of the map, with commas between; empty: none.", examples=["car,person"]
    )
    limit: int = Field(10, ge=1, le=100, description="Views that would lose most, at most so many.")

    def labels(self) -> tuple[str, ...]:
        """The labels."""
        return tuple(name.strip() for name in self.dynamic.split(",") if name.strip())


async def _body(request: Request, model: type[M], largest: int = LARGEST_JSON) -> M:
    """The JSON body as a model; raises BadBody, BodyTooLarge, InvalidParameters."""
    return validated(model, await json_object(request, largest), strict=True)


@router.get("/maps", response_model=Maps, responses=refusals())
async def list_maps(curator: Curates, access: Accesses) -> Response:
    """All maps that the caller may use, by name."""
    return Response(await curator.maps(access.maps), media_type="application/json")


@router.get("/maps/{map}", response_model=MapFacts, responses=refusals("not-found"))
async def get_map(name: MapName, curator: Curates) -> MapFacts:
    """One map: counts, recipe, labels, extent."""
    return await curator.map(name)


@router.put(
    "/maps/{map}",
    response_model=MapFacts,
    openapi_extra=takes_map(),
    responses={
        200: {"description": "The map has this recipe."},
        201: {"model": MapFacts, "description": "The map was made."},
        **refusals("malformed-body", "conflict", "body-too-large", "disk-full"),
    },
)
async def put_map(name: MapName, request: Request, curator: Curates) -> Response:
    """Make a map, or give an empty one other labels, preset or parameters."""
    facts, created = await curator.put_map(name, await _body(request, PutMap))
    return JSONResponse(facts.model_dump(mode="json"), 201 if created else 200)


@router.patch(
    "/maps/{map}",
    response_model=MapFacts,
    openapi_extra=takes_json(
        {"$ref": "#/components/schemas/PatchMap"},
        media_types=("application/merge-patch+json", "application/json"),
        required=True,
        example={"ranking": {"candidates": 100}},
    ),
    responses=refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full"),
)
async def patch_map(name: MapName, request: Request, curator: Curates) -> MapFacts:
    """Change the ranking of a map, what it keeps of images and queries, or whether it refuses poor images.

    All that is sent is changed, or, when one of it is refused, nothing.
    """
    changes = await _body(request, PatchMap)
    if changes == PatchMap():
        raise InvalidParameters.of("ranking", f"is missing: some of {', '.join(PatchMap.model_fields)} are needed")
    return await curator.change_map(name, changes)


@router.delete("/maps/{map}", response_model=Deleted, responses=refusals("not-found"))
async def delete_map(name: MapName, curator: Curates, access: Accesses) -> Deleted:
    """Delete a map, its views and their images."""
    return allowed(await curator.delete_map(name), access.may_use)


@router.post(
    "/maps/{map}/recipe",
    status_code=202,
    response_model=Job,
    openapi_extra=takes_map(PostRecipe, shadow=100),
    responses={**STARTED, **refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full")},
)
async def switch_recipe(name: MapName, request: Request, curator: Curates) -> Response:
    """Describe all views of a map by another recipe; until that is done, queries use the old one.

    With `shadow` the map goes on with the old one, and both answer queries, until it is told which stays.
    """
    return started(await curator.switch_recipe(name, await _body(request, PostRecipe)))


@previews.get("/maps/{map}/dynamic", response_model=DynamicPreview, responses=refusals("not-found", "conflict"))
async def preview_dynamic(
    name: MapName, params: Annotated[PreviewParameters, Query()], curator: Curates
) -> DynamicPreview:
    """What other dynamic labels would leave out of the map's views; `POST /maps/{map}/recipe` describes them so."""
    return await curator.dynamic_preview(name, params.labels(), params.limit)


@router.post(
    "/maps/{map}/vocabulary",
    status_code=202,
    response_model=Job,
    responses={**STARTED, **refusals("not-found", "conflict", "disk-full")},
)
async def train_vocabulary(name: MapName, curator: Curates) -> Response:
    """Train a vocabulary on the map's own views, then describe them by it."""
    return started(await curator.train_vocabulary(name))


@router.post(
    "/maps/{map}/calibration",
    response_model=CalibrationReport,
    openapi_extra=takes_json({"$ref": "#/components/schemas/PostCalibration"}, required=True, example=POST_CALIBRATION),
    responses={
        200: {"content": {"application/json": {"example": CALIBRATION_REPORT}}},
        **refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full"),
    },
)
async def calibrate(name: MapName, request: Request, curator: Curates) -> CalibrationReport:
    """Fit the map's confidences to labelled queries of its own, judge that on held-out ones, and keep it if it helps.

    It is dropped when the map's recipe changes, or its ranking (other than `precision`).
    """
    return await curator.calibrate(name, await _body(request, PostCalibration, MOST_LABELS))


@router.delete("/maps/{map}/calibration", response_model=MapFacts, responses=refusals("not-found", "disk-full"))
async def forget_calibration(name: MapName, curator: Curates) -> MapFacts:
    """Return the map to the shipped calibration."""
    return await curator.forget_calibration(name)
