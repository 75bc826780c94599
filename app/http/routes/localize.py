"""`POST /localize/geopose`: the OSCP GeoPose protocol, version 2, for apps that localise themselves."""

import asyncio
import json
import time
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from pydantic import ValidationError

from app.http.body import json_object
from app.http.callers import caller_of
from app.http.dependencies import Measures, Recognises, checked
from app.http.geopose import OSCP, OSCP_VERSION, GeoPoseRequest, oscp_answer, speaks_oscp
from app.http.keys import Accesses, check_map
from app.http.openapi import OF_IMAGES, refusals, takes_json
from app.http.query_parameters import LocalizeParameters
from app.http.rate_limits import charge_images
from app.http.validation import problems_of
from schemas.errors import BadBody, InvalidParameters, NoPose
from schemas.records import Filters
from worker.service.query_options import QueryOptions

router = APIRouter(tags=["enrol and query"], dependencies=checked)

LARGEST = 1 << 31
"""Bytes; REVISIT_MAX_BODY_MB has refused what is larger before."""

EXAMPLE = {
    "id": "8f6e6e1e-3d3f-4f0d-9d57-0a9f5f6f7f10",
    "timestamp": 1767225600000,
    "type": "geopose",
    "sensors": [{"id": "0", "type": "camera"}],
    "sensorReadings": {"cameraReadings": [{"timestamp": 1767225600000, "sensorId": "0", "imageBytes": "/9j/4AAQ..."}]},
}
ANSWER = {
    "id": EXAMPLE["id"],
    "timestamp": 1767225600123,
    "type": "geopose",
    "accuracy": {"position": 3.5, "orientation": 20.0},
    "geopose": {
        "position": {"lat": 50.0755, "lon": 14.4378, "h": 190.0},
        "quaternion": {"x": 0.0, "y": 0.0, "z": 0.38, "w": 0.92},
    },
}
_REFUSALS = refusals(
    "not-found",
    "conflict",
    "malformed-body",
    "bad-request",
    *OF_IMAGES,
    "too-many-requests",
)
_REFUSALS[404]["content"][OSCP] = {"schema": {"type": "object"}, "example": {"ERROR": "no place stands out"}}


@router.post(
    "/localize/geopose",
    response_class=Response,
    openapi_extra=takes_json(
        {"type": "object"}, media_types=("application/json", OSCP), required=True, example=EXAMPLE
    ),
    responses={
        200: {
            "description": "The pose of the views that match, and how far off it may be.",
            "content": {OSCP: {"schema": {"type": "object"}, "example": ANSWER}},
        },
        **_REFUSALS,
    },
)
async def localize(
    request: Request,
    params: Annotated[LocalizeParameters, Query()],
    recogniser: Recognises,
    metrics: Measures,
    access: Accesses,
) -> Response:
    """Where was this image taken? Answers the pose of the views that show its place."""
    check_map(access, params.map)
    if not speaks_oscp(",".join(request.headers.getlist("accept"))):
        raise BadBody("bad-request", f"send `Accept: {OSCP_VERSION}`, the version that is spoken here")
    wanted = _read(await json_object(request, LARGEST))
    charge_images(request, 1)
    near = wanted.near()
    options = QueryOptions(
        filters=Filters(near=near, geographic=None if near is None else True),
        precision=params.precision,
        keep=wanted.may_be_kept(),
    )
    async with caller_of(request) as caller:
        image = await asyncio.to_thread(wanted.image)
        answer = await recogniser.query(image, params.map, options=options, caller=caller)
    metrics.queried(answer)
    try:
        return _answer(oscp_answer(wanted.id, time.time_ns() // 1_000_000, answer), 200)
    except NoPose as nothing:
        return _answer({"ERROR": nothing.detail}, 404)


def _read(body: dict[str, object]) -> GeoPoseRequest:
    try:
        return GeoPoseRequest.model_validate(body)
    except ValidationError as error:
        raise InvalidParameters(problems_of(error, GeoPoseRequest)) from None


def _answer(content: dict[str, object], status: int) -> Response:
    return Response(json.dumps(content), status, media_type=OSCP_VERSION)
