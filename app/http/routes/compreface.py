"""`/compat/compreface/{map}`: the recognition service of CompreFace, for apps that change their base URL alone."""

from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from app.http import compreface as shapes
from app.http.body import json_object
from app.http.callers import caller_of
from app.http.curate import Curator
from app.http.dependencies import Curates, MapName, Measures, Recognises, ViewId, checked, no_parameters
from app.http.openapi import OF_IMAGES, answers_bytes, refusals, takes_json
from app.http.recognise import Recogniser
from app.http.routes import images
from app.http.scopes import COMPREFACE
from app.http.validation import validated
from app.version import VERSION
from schemas.errors import NotFound, RevisitError
from schemas.records import Filters, Position, ViewAttributes
from schemas.values import spellings
from schemas.wire import QueryAnswer, View
from worker.service.query_options import QueryOptions

router = APIRouter(prefix=COMPREFACE, tags=["compatible services"], dependencies=checked)

PAGE = 500
"""Views or places that are read at once."""

SubjectName = Annotated[str, Path(min_length=1, max_length=200, description="Name of the place.")]

_NAME = {"type": "string", "minLength": 1, "maxLength": 200, "description": "Name of the place."}
_FILE = "JPEG, PNG, WebP, BMP, TIFF or HEIC"
_SUBJECT: dict[str, Any] = takes_json(
    {"type": "object", "properties": {"subject": _NAME}},
    required=True,
    example={"subject": "hall"},
)
_IMAGE: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "properties": {"file": {"type": "string", "format": "binary", "description": _FILE}},
                }
            },
            "application/json": {
                "schema": {
                    "type": "object",
                    "properties": {"file": {"type": "string", "description": f"{_FILE}, in base64."}},
                },
                "example": {"file": "/9j/4AAQ..."},
            },
        },
    }
}
_QUERIED = (
    "no-picture",
    "malformed-body",
    "not-found",
    "conflict",
    *OF_IMAGES,
    "too-many-requests",
)


# subjects


@router.get("/subjects", dependencies=[no_parameters], responses=refusals("not-found"))
async def subjects(name: MapName, curator: Curates) -> shapes.Subjects:
    """Names of all places of the map."""
    return shapes.Subjects(subjects=await _places(curator, name))


@router.post(
    "/subjects",
    status_code=201,
    dependencies=[no_parameters],
    openapi_extra=_SUBJECT,
    responses=refusals("malformed-body", "body-too-large"),
)
async def add_subject(name: MapName, request: Request) -> shapes.Subject:
    """Take the name of a place; it is listed from its first example on."""
    return shapes.Subject(subject=_name(await json_object(request)))


@router.put(
    "/subjects/{subject:path}",
    dependencies=[no_parameters],
    openapi_extra=_SUBJECT,
    responses=refusals("malformed-body", "not-found", "body-too-large", "disk-full"),
)
async def rename_subject(name: MapName, subject: SubjectName, request: Request, curator: Curates) -> shapes.Renamed:
    """Give a place another name; where there is one of this name, both become one."""
    wanted = _name(await json_object(request))

    updated = False

    def renamed(attributes: ViewAttributes) -> ViewAttributes:
        nonlocal updated
        if attributes.place not in spellings(subject):  # somebody gave the view to another place meanwhile
            return attributes
        updated = True
        return replace(attributes, place=wanted)

    for view in [view async for view in _each(curator, name, subject)]:
        with suppress(NotFound):  # deleted meanwhile; the others are renamed all the same
            await curator.patch_view(view.id, renamed)
    return shapes.Renamed(updated=updated)


@router.delete("/subjects/{subject:path}", dependencies=[no_parameters], responses=refusals("not-found", "conflict"))
async def delete_subject(name: MapName, subject: SubjectName, curator: Curates) -> shapes.Subject:
    """Delete a place: all its views."""
    if not (await curator.delete_views(name, Filters(place=subject))).views:
        raise NotFound("place", subject)
    return shapes.Subject(subject=subject)


@router.delete("/subjects", dependencies=[no_parameters], responses=refusals("not-found", "conflict"))
async def delete_subjects(name: MapName, curator: Curates) -> shapes.Count:
    """Delete all places: every view of the map. Answers how many places there were."""
    count = len(await _places(curator, name))
    await curator.delete_views(name, Filters())
    return shapes.Count(deleted=count)


# examples


@router.post(
    "/faces", status_code=201, openapi_extra=_IMAGE, responses=refusals(*_QUERIED, "poor-picture", "disk-full")
)
async def add_example(
    name: MapName,
    params: Annotated[shapes.Example, Query()],
    request: Request,
    recogniser: Recognises,
    metrics: Measures,
) -> shapes.ExampleFacts:
    """Enrol an image of a place."""
    image = await shapes.one_image(request)
    attributes = ViewAttributes(place=params.subject, position=Position())
    [outcome] = await recogniser.enroll([image], name, attributes, True, refuse_poor=None)
    if isinstance(outcome, RevisitError):
        raise outcome
    metrics.stages("enroll", outcome.timing_ms)
    return shapes.example(outcome.view)


@router.get("/faces", responses=refusals("not-found"))
async def examples(name: MapName, params: Annotated[shapes.Examples, Query()], curator: Curates) -> shapes.ExamplePage:
    """A page of the views of the map, in the order of enrolment."""
    first, count = params.page * params.size, 0
    total = None if params.subject is not None else sum((await curator.map(name)).views.values())
    found: list[View] = []
    if total is None or first < total:
        async for view in _each(curator, name, params.subject):  # a large map does not fit into memory
            if first <= count < first + params.size:
                found.append(view)
            count += 1
            if total is not None and count == first + params.size:
                break
    total = count if total is None else total
    return shapes.ExamplePage(
        faces=[shapes.example(view) for view in found],
        page_number=params.page,
        page_size=params.size,
        total_pages=-(-total // params.size),
        total_elements=total,
    )


@router.delete("/faces", responses=refusals("not-found", "conflict"))
async def delete_examples(
    name: MapName, params: Annotated[shapes.ExamplesOf, Query()], curator: Curates
) -> shapes.Count:
    """Delete the views of a place, or of the whole map."""
    return shapes.Count(deleted=(await curator.delete_views(name, Filters(place=params.subject))).views)


@router.delete("/faces/{view_id}", dependencies=[no_parameters], responses=refusals("not-found"))
async def delete_example(name: MapName, view_id: ViewId, curator: Curates) -> shapes.ExampleFacts:
    """Delete one view."""
    view = await _view(curator, name, view_id)
    await curator.delete_view(view_id)
    return shapes.example(view)


@router.get(
    "/faces/{view_id}/img",
    response_class=Response,
    dependencies=[no_parameters],
    responses={
        **answers_bytes(*images.TYPES, description="The image, as `GET /views/{view_id}/image`.", etag=True),
        **refusals("not-found", "image-not-kept"),
    },
)
async def example_image(name: MapName, view_id: ViewId, request: Request, curator: Curates) -> Response:
    """The image of one view."""
    await _view(curator, name, view_id)
    return await images.image(view_id, request, curator)


# recognition


@router.post("/recognize", openapi_extra=_IMAGE, responses=refusals(*_QUERIED), response_model_exclude_none=True)
async def recognize(
    name: MapName,
    params: Annotated[shapes.Recognition, Query()],
    request: Request,
    recogniser: Recognises,
    metrics: Measures,
) -> shapes.Recognitions:
    """Which place does this image show? Act on `status`; `similarity` is the probability of each place."""
    return shapes.recognised(await _query(request, name, recogniser, metrics), params, VERSION)


@router.post(
    "/faces/{view_id}/verify",
    openapi_extra=_IMAGE,
    responses=refusals(*_QUERIED),
    response_model_exclude_none=True,
)
async def verify(
    name: MapName,
    view_id: ViewId,
    params: Annotated[shapes.Detection, Query()],
    request: Request,
    recogniser: Recognises,
    curator: Curates,
    metrics: Measures,
) -> shapes.Verifications:
    """Does this image show the place of that view? Compared with the whole map: alone it would say little."""
    view = await _view(curator, name, view_id)
    return shapes.verified(await _query(request, name, recogniser, metrics), view, params, VERSION)


async def _query(request: Request, name: str, recogniser: Recogniser, metrics: Measures) -> QueryAnswer:
    _, image = await shapes.one_image(request)
    async with caller_of(request) as caller:
        answer = await recogniser.query(image, name, options=QueryOptions(top=10), caller=caller)
    metrics.queried(answer)
    return answer


async def _places(curator: Curator, name: str) -> list[str]:
    found: list[str] = []
    cursor = None
    while True:
        page = await curator.places(name, cursor, PAGE)
        found += [place.place for place in page.places]
        cursor = page.next
        if cursor is None:
            return found


async def _each(curator: Curator, name: str, place: str | None) -> AsyncIterator[View]:
    """The views of a map, or of one of its places, in the order of enrolment."""
    cursor = None
    while True:
        page = await curator.views(
            name, Filters(place=place), state=None, newest_first=False, cursor=cursor, limit=PAGE
        )
        for view in page.views:
            yield view
        cursor = page.next
        if cursor is None:
            return


async def _view(curator: Curator, name: str, view_id: str) -> View:
    view = await curator.view(view_id)
    if view.map != name:
        raise NotFound("view", view_id)
    return view


def _name(body: dict[str, Any]) -> str:
    """The name of a place in a body; the rest of the body is not read."""
    return validated(shapes.NamedPlace, {"subject": body.get("subject")}, strict=True).subject
