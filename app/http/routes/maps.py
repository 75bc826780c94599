"""`/maps`: make, look at, re-describe and delete maps."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import JSONResponse, Response
from pydantic import ValidationError

from app.http.body import json_object
from app.http.dependencies import Curates, map_in_path, no_parameters
from app.http.openapi import refusals, takes_json, takes_map
from app.http.parameters import problems_of
from schemas.errors import InvalidParameters
from schemas.requests import PatchMap, PutMap
from schemas.wire import Deleted, Job, MapFacts, Maps

router = APIRouter(tags=["maps"], dependencies=[no_parameters])

Name = Annotated[str, Depends(map_in_path)]

_PATH: dict[str, Any] = {
    "parameters": [
        {
            "name": "map",
            "in": "path",
            "required": True,
            "description": "Name of the map.",
            "schema": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"},
        }
    ]
}
_STARTED: dict[str, Any] = {"headers": {"Location": {"description": "The job.", "schema": {"type": "string"}}}}


async def wanted_map(request: Request) -> PutMap:
    """The body of a request that describes a map; raises BadBody, BodyTooLarge, InvalidParameters."""
    try:
        return PutMap.model_validate(await json_object(request), strict=True)
    except ValidationError as error:
        raise InvalidParameters(problems_of(error, PutMap)) from None


async def map_changes(request: Request) -> PatchMap:
    """The body of a change of a map; raises as `wanted_map`."""
    try:
        return PatchMap.model_validate(await json_object(request), strict=True)
    except ValidationError as error:
        raise InvalidParameters(problems_of(error, PatchMap)) from None


Wanted = Annotated[PutMap, Depends(wanted_map)]


@router.get("/maps", response_model=Maps, responses=refusals())
async def list_maps(curator: Curates) -> Maps:
    """All maps, by name."""
    return await curator.maps()


@router.get("/maps/{map}", response_model=MapFacts, openapi_extra=_PATH, responses=refusals("not-found"))
async def get_map(name: Name, curator: Curates) -> MapFacts:
    """One map: counts, recipe, labels, extent."""
    return await curator.map(name)


@router.put(
    "/maps/{map}",
    response_model=MapFacts,
    openapi_extra=_PATH | takes_map(),
    responses={
        200: {"description": "The map is as asked for."},
        201: {"model": MapFacts, "description": "The map was made."},
        **refusals("malformed-body", "conflict", "body-too-large", "disk-full"),
    },
)
async def put_map(name: Name, wanted: Wanted, curator: Curates) -> Response:
    """Make a map, or give an empty one other labels, preset or parameters."""
    facts, created = await curator.put_map(name, wanted)
    return JSONResponse(facts.model_dump(mode="json"), 201 if created else 200)


@router.patch(
    "/maps/{map}",
    response_model=MapFacts,
    openapi_extra=_PATH
    | takes_json(
        {"$ref": "#/components/schemas/PatchMap"},
        media_types=("application/merge-patch+json", "application/json"),
        example={"ranking": {"candidates": 100}},
    ),
    responses=refusals("malformed-body", "not-found", "body-too-large", "disk-full"),
)
async def patch_map(name: Name, changes: Annotated[PatchMap, Depends(map_changes)], curator: Curates) -> MapFacts:
    """Change how a map ranks, from the next query on; nothing is described anew."""
    return await curator.change_ranking(name, changes.ranking)


@router.delete("/maps/{map}", response_model=Deleted, openapi_extra=_PATH, responses=refusals("not-found"))
async def delete_map(name: Name, curator: Curates) -> Deleted:
    """Delete a map, its views and their pictures."""
    return await curator.delete_map(name)


@router.post(
    "/maps/{map}/recipe",
    status_code=202,
    response_model=Job,
    openapi_extra=_PATH | takes_map(),
    responses={202: _STARTED, **refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full")},
)
async def switch_recipe(name: Name, wanted: Wanted, curator: Curates) -> Response:
    """Describe all views of a map anew; queries are answered by the old recipe until that is done."""
    return _started(await curator.switch_recipe(name, wanted))


@router.post(
    "/maps/{map}/vocabulary",
    status_code=202,
    response_model=Job,
    openapi_extra=_PATH,
    responses={202: _STARTED, **refusals("not-found", "conflict", "disk-full")},
)
async def train_vocabulary(name: Name, curator: Curates) -> Response:
    """Train a vocabulary on the map's own views, and describe them by it."""
    return _started(await curator.train_vocabulary(name))


def _started(job: Job) -> Response:
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": f"/jobs/{job.id}"})
