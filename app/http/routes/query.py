"""`POST /query`: have I been here before, and where is here?"""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.http.body import PICTURE_PART, take
from app.http.dependencies import Measures, Recognises
from app.http.examples import QUERY_ANSWER
from app.http.openapi import asks_pictures, refusals
from app.http.parameters import QueryParameters, read
from schemas.errors import ParameterError
from schemas.wire import QueryAnswer

router = APIRouter(tags=["enrol and ask"])


@router.post(
    "/query",
    response_model=QueryAnswer,
    openapi_extra=asks_pictures(QueryParameters, several=False),
    responses={
        200: {"content": {"application/json": {"example": QUERY_ANSWER}}},
        **refusals(
            "no-picture",
            "malformed-body",
            "not-found",
            "body-too-large",
            "not-a-picture",
            "undecodable-picture",
            "picture-too-large",
            "picture-too-small",
            "nothing-static",
            "too-many-requests",
        ),
    },
)
async def query(request: Request, recogniser: Recognises, metrics: Measures) -> Response:
    """Which views of a map show the place of this picture?"""
    sent = await take(request)
    errors = list(sent.errors)
    if len(sent.pictures) > 1:
        errors.append(ParameterError(PICTURE_PART, f"{len(sent.pictures)} pictures; a question is about one"))
    asked = read(QueryParameters, sent.parameters, errors)
    answer = await recogniser.query(
        sent.pictures[0][1],
        asked.map,
        top=asked.top,
        candidates=asked.candidates,
        filters=asked.filters(),
        explain=asked.explain,
        drive=asked.drive,
    )
    metrics.stages("query", answer.timing_ms)
    return Response(answer.model_dump_json(), media_type="application/json")
