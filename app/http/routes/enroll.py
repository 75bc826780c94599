"""`POST /enroll`: keep images and their attributes."""

import asyncio
from collections.abc import Sequence

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.http.body import take
from app.http.body_room import LET_GO
from app.http.dependencies import Curates, Measures, Recognises
from app.http.examples import ENROLLED
from app.http.idempotency import fingerprint, header, key_of, once
from app.http.keys import Accesses, check_map
from app.http.notes import note, note_problem
from app.http.openapi import OF_IMAGES, refusals, takes_images
from app.http.parameters import EnrollParameters
from app.http.problems import KINDS, URN, code_of
from app.http.rate_limits import charge_images
from app.http.validation import read
from schemas.errors import Busy, InvalidParameters, ParameterError, RevisitError
from schemas.wire import Enrolled, EnrolledMany, EnrolmentError, ProblemParameter

router = APIRouter(tags=["enrol and query"])

_LOCATION = {"Location": {"description": "The view, or the job that describes it.", "schema": {"type": "string"}}}
_KEY = header("A new key for every new request; repeating a request with its key repeats the answer for 24 hours.")
_ANY = Enrolled | EnrolledMany


@router.post(
    "/enroll",
    status_code=201,
    response_model=_ANY,
    openapi_extra=takes_images(EnrollParameters, several=True, headers=[_KEY]),
    responses={
        200: {"model": _ANY, "description": "The map has these very bytes already.", "headers": _LOCATION},
        201: {
            "description": "Durable and searchable.",
            "headers": _LOCATION,
            "content": {"application/json": {"example": ENROLLED}},
        },
        202: {"model": _ANY, "description": "Durable; `job` describes it.", "headers": _LOCATION},
        207: {
            "model": EnrolledMany,
            "description": "Some images were refused; `errors` says why. With `Retry-After` repeat the call: the "
            "service was full or away, and keeps no such answer for its Idempotency-Key.",
        },
        **refusals(
            "no-picture",
            "malformed-body",
            "conflict",
            *OF_IMAGES,
            "poor-picture",
            "idempotency-key-reused",
            "too-many-requests",
            "disk-full",
        ),
    },
)
async def enroll(
    request: Request, recogniser: Recognises, curator: Curates, metrics: Measures, access: Accesses
) -> Response:
    """Enrol one or several images in a map."""
    sent = await take(request)
    charge_images(request, len(sent.images))
    errors = list(sent.errors)
    if len(sent.images) > 1 and any(name == "filename" for name, _ in sent.parameters):
        errors.append(ParameterError("filename", f"names one image; each of {len(sent.images)} has its part's name"))
    params = read(EnrollParameters, sent.parameters, errors)
    check_map(access, params.map)
    images = [(params.filename or name, data) for name, data in sent.images]
    names = [name for name, _ in sent.images]
    key = key_of(request, access)
    print_ = ""
    if key is not None:
        print_ = await asyncio.to_thread(fingerprint, [data for _, data in images], sent.parameters)
    del sent  # the images go once they are stored

    async def work() -> Response:
        outcomes = await recogniser.enroll(
            images,
            params.map,
            params.attributes(),
            params.wait,
            refuse_poor=params.refuse_poor,
            exif=params.exif,
            stored=request.scope["state"][LET_GO],
        )
        for outcome in outcomes:
            if isinstance(outcome, Enrolled):
                metrics.stages("enroll", outcome.timing_ms)
        note(
            view_ids=[one.view.id for one in outcomes if isinstance(one, Enrolled)],
            job_ids=[one.job for one in outcomes if isinstance(one, Enrolled) and one.job],
        )
        return _answer(names, outcomes)

    return await work() if key is None else await once(curator, request, key, print_, work)


def _answer(names: Sequence[str | None], outcomes: list[Enrolled | RevisitError]) -> Response:
    """One image: its view or error. Several: a list of both; an error when all were refused."""
    views = [o for o in outcomes if isinstance(o, Enrolled)]
    refused = [(index, o) for index, o in enumerate(outcomes) if isinstance(o, RevisitError)]
    if len(outcomes) == 1 and refused:
        raise refused[0][1]
    if not views:
        raise _all_refused(refused)
    body: Enrolled | EnrolledMany = views[0]
    if len(outcomes) > 1:
        body = EnrolledMany(
            views=views,
            errors=[_refusal(index, names[index], error) for index, error in refused],
            revision=max(view.revision for view in views),
            timing_ms=_slowest(views),
        )
    headers = _try_again([error for _, error in refused])
    if len(outcomes) == 1:
        headers["Location"] = f"/jobs/{views[0].job}" if views[0].job else views[0].view.links.self
    return Response(body.model_dump_json(), _status(views, bool(refused)), headers, "application/json")


def _try_again(errors: list[RevisitError]) -> dict[str, str]:
    """Retry-After, where some images were refused for what may go away; with it the call may be repeated as it was."""
    waits = [error.retry_after_s if isinstance(error, Busy) else 1 for error in errors if _may_go_away(error)]
    return {"Retry-After": str(max(waits))} if waits else {}


def _may_go_away(error: RevisitError) -> bool:
    return KINDS[code_of(error)].status in (429, 503, 507)


def _status(views: list[Enrolled], some_refused: bool) -> int:
    if some_refused:
        return 207
    if any(view.job for view in views):
        return 202
    return 201 if any(view.created for view in views) else 200


def _refusal(index: int, filename: str | None, error: RevisitError) -> EnrolmentError:
    code = code_of(error)
    note_problem(code)
    kind = KINDS[code]
    return EnrolmentError(
        index=index,
        filename=filename,
        type=URN + code,
        title=kind.title,
        status=kind.status,
        detail=error.detail,
        errors=[ProblemParameter(parameter=e.parameter, detail=e.detail) for e in error.errors]
        if isinstance(error, InvalidParameters)
        else [],
    )


def _all_refused(refused: list[tuple[int, RevisitError]]) -> RevisitError:
    """The first error that may go away later (`Busy`), else the first; its detail lists all images."""
    first = next((error for _, error in refused if isinstance(error, Busy)), refused[0][1])
    first.detail = "; ".join(f"image {index}: {error.detail}" for index, error in refused)
    return first


def _slowest(views: list[Enrolled]) -> dict[str, float]:
    """The longest time of each stage, in ms: images of one request are described in parallel."""
    times: dict[str, float] = {}
    for view in views:
        for stage, milliseconds in view.timing_ms.items():
            times[stage] = max(times.get(stage, 0.0), milliseconds)
    return times
