"""Errors as RFC 9457 problem+json: the table of problem types, and the handlers that answer them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from app.http.notes import note_problem, noted_path
from app.http.scopes import methods_of
from app.http.validation import in_words
from schemas.errors import (
    MOST_MISTAKES,
    BadBody,
    Busy,
    CallerGone,
    InvalidParameters,
    NotFound,
    ParameterError,
    RangeOutside,
    RevisitError,
    SetupError,
    Unauthorized,
    Unavailable,
    echoed,
)
from schemas.threads import NO_MORE_THREADS, is_shortage
from schemas.wire import Problem, ProblemParameter

logger = logging.getLogger("revisit.http")

MEDIA_TYPE = "application/problem+json"
URN = "urn:revisit:problem:"


@dataclass(frozen=True)
class Kind:
    """One kind of problem.

    Parameters
    ----------
    status : int
        HTTP status.
    title : str
        Short summary, the same for every problem of this kind.
    remedy : str
        What the caller can do; docs/errors.md says the same.
    """

    status: int
    title: str
    remedy: str


KINDS: Mapping[str, Kind] = {
    "no-picture": Kind(400, "No image was sent", "Send the image as the multipart part `image` or as the body."),
    "malformed-body": Kind(400, "The body cannot be parsed", "Let an HTTP library write the body, and send all of it."),
    "bad-request": Kind(400, "The request cannot be understood", "Compare it with /docs."),
    "unexpected-body": Kind(400, "This request takes no body", "Leave the body out."),
    "unauthorized": Kind(401, "A key is needed", "Send a valid key."),
    "forbidden": Kind(403, "The key does not allow this", "Use a key with the needed scope and map."),
    "other-site": Kind(
        403, "Pages of other sites may not do this", "Call by localhost, send a key, or see `REVISIT_CORS`."
    ),
    "not-found": Kind(404, "There is no such thing", "Check the id or name; `GET /maps` and `GET /views` list them."),
    "image-not-kept": Kind(
        404, "The image is not kept", "Show something else in its place; `keep_images` of the map is false."
    ),
    "no-pose": Kind(
        404, "The image gives no geographic pose", "Follow `detail`; without the Accept header the answer says more."
    ),
    "method-not-allowed": Kind(405, "The address does not answer this method", "Use a method that `Allow` names."),
    "request-timeout": Kind(408, "The request did not arrive in time", "Send it again, over a faster connection."),
    "conflict": Kind(
        409, "It contradicts the present state or work under way", "Wait for the other call, or follow `detail`."
    ),
    "body-too-large": Kind(413, "The body is too large", "Send fewer or smaller images; JPEG is compact."),
    "not-a-picture": Kind(
        415,
        "This is not an image of an accepted type",
        "Send JPEG, PNG, WebP, BMP, TIFF or HEIC with its content type.",
    ),
    "range-not-satisfiable": Kind(
        416, "There are no such bytes", "Ask for bytes of which `Content-Range` names the number, or for all of them."
    ),
    "invalid-parameter": Kind(422, "Parameters cannot be used", "Correct each parameter that `errors` lists."),
    "undecodable-picture": Kind(
        422, "The image is truncated or corrupt", "Send the whole file; open it elsewhere to see whether it is sound."
    ),
    "picture-too-large": Kind(
        422,
        "The image has too many pixels",
        "Scale it down, 1280 pixels a side are plenty; cut one that is more than 50 times as long as wide.",
    ),
    "picture-too-small": Kind(422, "The image has too few pixels", "Send at least 32 x 32 pixels."),
    "poor-picture": Kind(
        422, "The image is too poor to enrol", "Take the photo again, or enrol it as it is without `refuse_poor`."
    ),
    "nothing-static": Kind(
        422, "The image shows dynamic labels only", "Take the photo again when less is in the way, or change `dynamic`."
    ),
    "idempotency-key-reused": Kind(
        422, "The Idempotency-Key belongs to another request", "Use a new key for every new request."
    ),
    "too-many-requests": Kind(429, "Too many requests", "Try again after `Retry-After` seconds."),
    "headers-too-large": Kind(431, "The headers are too large", "Send fewer or shorter headers and parameters."),
    "internal": Kind(500, "The service failed", "Try again; report it with the request id, which the log has too."),
    "damaged": Kind(
        500,
        "Stored data is damaged",
        "Enrol the image again, or have `./revisit doctor --repair` run; do not retry.",
    ),
    "unavailable": Kind(
        503, "The service cannot do this now", "Follow `detail`; try again after `Retry-After` seconds."
    ),
    "disk-full": Kind(507, "The disk is full", "Free space or delete views; reading and deleting still work."),
}
"""All problem types by their codes."""


class OscpProblem(Problem):
    """An error for clients of the OSCP GeoPose protocol."""

    ERROR: str = Field(description="`detail` again, where clients of this protocol look for it.")


class CompreFaceProblem(Problem):
    """An error for clients of CompreFace."""

    message: str = Field(description="`detail` again, where clients of CompreFace look for it.")


_SHAPES: Mapping[str, type[Problem]] = {"/localize/geopose": OscpProblem, "/compat/compreface/": CompreFaceProblem}
"""Paths, or what they begin with, whose protocols have a name of their own for what is wrong."""


def shape_of(path: str) -> type[Problem]:
    """The model of a problem that is answered at a path."""
    return next((shape for start, shape in _SHAPES.items() if path.startswith(start)), Problem)


def own_members(shape: type[Problem], detail: str) -> dict[str, str]:
    """What a shape has besides the members of every problem."""
    return dict.fromkeys(shape.model_fields.keys() - Problem.model_fields.keys(), detail)


_OF_STATUS = {404: "not-found", 405: "method-not-allowed", 413: "body-too-large"}

THREADS_RETRY_S = 5

_INTERNAL_DETAIL = "something went wrong inside the service; its log has the reason under this request id"


def request_id(request: Request) -> str:
    """The id that `app.http.middleware` gave the request."""
    return str(getattr(request.state, "request_id", "none"))


def problem(
    code: str,
    detail: str,
    request_id: str,
    *,
    errors: Sequence[ParameterError] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The answer for a problem of one kind; `code` is a key of `KINDS`."""
    kind = KINDS[code]
    note_problem(code)
    shape = shape_of(noted_path())
    body = shape(
        type=URN + code,
        title=kind.title,
        status=kind.status,
        detail=detail,
        errors=[ProblemParameter(parameter=e.parameter, detail=e.detail) for e in errors],
        request_id=request_id,
        **own_members(shape, detail),
    )
    return Response(body.model_dump_json(), kind.status, dict(headers or {}), MEDIA_TYPE)


def code_of(error: RevisitError) -> str:
    """The code that a client gets for an error; codes that are not in `KINDS` become `internal`."""
    if isinstance(error, SetupError):
        # While the service runs, this concerns one map: its recipe needs another encoder or a vocabulary that is lost.
        return "conflict"
    return error.code if error.code in KINDS else "internal"


def problem_of(error: RevisitError, request_id: str) -> Response:
    """The answer for an error; an `internal` one is logged with its traceback."""
    code = code_of(error)
    if code == "internal":
        return internal(error, request_id)
    headers = {"Retry-After": str(error.retry_after_s)} if isinstance(error, Busy) else None
    if isinstance(error, Unauthorized):
        headers = {"WWW-Authenticate": 'Bearer realm="revisit"'}  # RFC 9110, 11.6.1
    if isinstance(error, RangeOutside):
        headers = {"Content-Range": f"bytes */{error.size}"}  # RFC 9110, 15.5.17
    errors = error.errors if isinstance(error, InvalidParameters) else ()
    return problem(code, error.detail, request_id, errors=errors, headers=headers)


def internal(error: BaseException, request_id: str) -> Response:
    """The answer 500: the log gets the traceback, the client the request id. 503 where no thread could be started."""
    if is_shortage(error):
        logger.error(NO_MORE_THREADS, extra={"event": "no_more_threads", "request_id": request_id})
        return problem_of(Unavailable(NO_MORE_THREADS, THREADS_RETRY_S), request_id)
    logger.error(
        "request failed",
        exc_info=(type(error), error, error.__traceback__),
        extra={"event": "request_failed", "request_id": request_id},
    )
    return problem("internal", _INTERNAL_DETAIL, request_id)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, RevisitError)
    return problem_of(error, request_id(request))


async def _http(request: Request, error: Exception) -> Response:
    """Answer what the framework refuses: unknown paths and methods."""
    assert isinstance(error, HTTPException)
    code = _OF_STATUS.get(error.status_code, "bad-request")
    if error.status_code >= 500:
        return internal(error, request_id(request))
    details = {
        "not-found": NotFound("address", request.url.path, "/docs lists all of them").detail,
        "method-not-allowed": f"{echoed(request.url.path)} does not answer {echoed(request.method)}",
    }
    headers = dict(error.headers or {})
    if "Allow" in headers:  # of one route; others may have the address too
        allowed = {*headers["Allow"].split(", "), *methods_of(request.url.path)}
        if "GET" in allowed:
            allowed.add("HEAD")  # app.http.addresses answers it
        headers["Allow"] = ", ".join(sorted(allowed))
    return problem(code, details.get(code, str(error.detail)), request_id(request), headers=headers)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[: MOST_MISTAKES + 1]
    errors = [in_words(one, one["loc"][1:]) for one in first]  # [0]: path or query
    return problem_of(InvalidParameters(errors), request_id(request))


async def _broken_off(request: Request, error: Exception) -> Response:
    # The client is gone, but the access log and the metrics count it as a 400 and not as a 500.
    return problem_of(BadBody("malformed-body", "the connection closed before the body ended"), request_id(request))


async def _unanswered(request: Request, error: Exception) -> None:
    """Send nothing: the access log and the metrics have the status 0, as of every connection that broke."""


def install(app: FastAPI) -> None:
    """Register the handlers; `app.http.middleware.RequestContext` answers all other exceptions."""
    app.add_exception_handler(RevisitError, _refused)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(ClientDisconnect, _broken_off)
    app.add_exception_handler(CallerGone, _unanswered)  # type: ignore[arg-type]  # Starlette sends no None
