"""`POST /query`: recognise the place of an image."""

import json

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.http.body import IMAGE_PART, take
from app.http.callers import caller_of
from app.http.changes_report import no_longer_kept, put_off
from app.http.dependencies import Curates, Measures, Recognises
from app.http.examples import QUERY_ANSWER
from app.http.geopose import OGC, basic_ypr, wants_geopose
from app.http.idempotency import header, key_of
from app.http.keys import Accesses, check_map
from app.http.openapi import OF_IMAGES, refusals, takes_images
from app.http.query_parameters import QueryParameters
from app.http.rate_limits import charge_images
from app.http.validation import read
from schemas import wire
from schemas.errors import Busy, NotFound, ParameterError
from schemas.wire import QueryAnswer
from worker.service.query_options import QueryOptions

router = APIRouter(tags=["enrol and query"])

_KEY = header("An image of a drive that is sent again with its key, since its answer was lost, counts once.")


@router.post(
    "/query",
    response_model=QueryAnswer,
    openapi_extra=takes_images(QueryParameters, several=False, headers=[_KEY]),
    responses={
        200: {"content": {"application/json": {"example": QUERY_ANSWER}, OGC: {"schema": {"type": "object"}}}},
        **refusals(
            "no-picture",
            "malformed-body",
            "not-found",
            "conflict",
            "no-pose",
            *OF_IMAGES,
            "too-many-requests",
        ),
    },
)
async def query(
    request: Request, recogniser: Recognises, curator: Curates, metrics: Measures, access: Accesses
) -> Response:
    """Which views of a map, or of several, show the place of this image?

    With `Accept: application/geopose+json` the answer is the pose of these views, as OGC GeoPose 1.0 (Basic-YPR).
    """
    sent = await take(request)
    charge_images(request, len(sent.images))
    errors = list(sent.errors)
    if len(sent.images) > 1:
        errors.append(ParameterError(IMAGE_PART, f"{len(sent.images)} images; a query takes one"))
    params = read(QueryParameters, sent.parameters, errors)
    for name in params.searched():
        check_map(access, name)
    options = QueryOptions(
        top=params.top,
        candidates=params.candidates,
        zoom=params.zoom,
        roll=params.roll,
        filters=params.filters(),
        precision=params.precision,
        explain=params.explain or params.changes,
        drive=None if params.drive is None else access.own(params.drive),
        drive_timeout_s=params.drive_timeout,
        consistent=params.consistent,
        call=key_of(request, access),
    )
    async with caller_of(request) as caller:
        answer = await recogniser.query(sent.images[0][1], *params.searched(), options=options, caller=caller)
        metrics.queried(answer)
        if params.changes:
            caller.check()  # it has photos encoded
            answer = answer.model_copy(update={"changes": await _changes(curator, answer.query.id)})
    if wants_geopose(",".join(request.headers.getlist("accept"))):
        return Response(json.dumps(basic_ypr(answer)), media_type=OGC)
    return Response(answer.model_dump_json(), media_type="application/json")


async def _changes(curator: Curates, query_id: str) -> wire.Changes:
    """What changed since the first match; the query is answered even where that cannot be compared."""
    try:
        return await curator.changes_of_query(query_id)
    except Busy as refused:
        return put_off(refused, query_id)
    except NotFound as gone:
        return no_longer_kept(gone)
