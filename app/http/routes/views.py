"""`/views`: list, show, correct and delete views."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from app.http.body import json_object
from app.http.dependencies import Curates, ViewId, checked, no_parameters
from app.http.examples import PATCH, VIEW
from app.http.keys import Accesses, check_map
from app.http.merge_patch import merge
from app.http.openapi import refusals, takes_json
from app.http.parameters import AttributesDocument, DeleteViews, ListViews
from app.http.snapshot_presenters import allowed
from app.http.validation import validated
from schemas.errors import InvalidParameters, ParameterError
from schemas.records import ViewAttributes
from schemas.values import METADATA_DEPTH, within_depth
from schemas.wire import Deleted, Position, View, Views, rfc3339

router = APIRouter(tags=["views"], dependencies=checked)

_VIEW: dict[int | str, dict[str, Any]] = {200: {"content": {"application/json": {"example": VIEW}}}}
_PATCH_SCHEMA: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "description": "JSON merge patch (RFC 7396) of the view's attributes; null removes.",
    "properties": {
        "place": {"type": ["string", "null"], "description": "Your own name for the place."},
        "position": {
            "type": ["object", "null"],
            "description": "Metres in the map's frame, or degrees; what is not named stays.",
            "additionalProperties": False,
            "properties": {name: {"type": ["number", "null"]} for name in Position.model_fields},
        },
        **{
            name: {"type": ["number", "null"], "description": "The same as in position, which is then not sent."}
            for name in Position.model_fields
        },
        "captured_at": {"type": ["string", "null"], "format": "date-time", "description": "RFC 3339 with its zone."},
        "metadata": {"type": ["object", "null"], "description": "Merged by name: null removes one, or all of it."},
    },
}
_FIELDS = ("place", "position", "captured_at", "metadata")
_KNOWN = frozenset((*_FIELDS, *Position.model_fields))


@router.get("/views", response_model=Views, responses=refusals("not-found"))
async def list_views(params: Annotated[ListViews, Query()], curator: Curates, access: Accesses) -> Views:
    """A page of views, in the order of enrolment; with `words`, by how much of them these labels are."""
    check_map(access, params.map)
    if params.words is not None and params.map is not None:
        return await curator.views_with_words(
            params.map, params.filters(), params.words, cursor=params.cursor, limit=params.limit
        )
    return await curator.views(
        params.map,
        params.filters(),
        state=params.state,
        newest_first=params.sort.startswith("-"),
        cursor=params.cursor,
        limit=params.limit,
        among=access.maps,
    )


@router.delete("/views", response_model=Deleted, responses=refusals("not-found", "conflict"))
async def delete_views(params: Annotated[DeleteViews, Query()], curator: Curates, access: Accesses) -> Deleted:
    """Delete the views of a map that pass the filters, or all of them with `all=true`."""
    check_map(access, params.map)
    return allowed(await curator.delete_views(params.map, params.filters()), access.may_use)


@router.get(
    "/views/{view_id}", response_model=View, dependencies=[no_parameters], responses={**_VIEW, **refusals("not-found")}
)
async def get_view(view_id: ViewId, curator: Curates) -> View:
    """One view."""
    return await curator.view(view_id)


@router.patch(
    "/views/{view_id}",
    response_model=View,
    dependencies=[no_parameters],
    openapi_extra=takes_json(
        _PATCH_SCHEMA, media_types=("application/merge-patch+json", "application/json"), example=PATCH
    ),
    responses={**_VIEW, **refusals("malformed-body", "not-found", "body-too-large", "disk-full")},
)
async def patch_view(view_id: ViewId, request: Request, curator: Curates) -> View:
    """Change attributes of a view: place, position (or its fields by themselves), captured_at, metadata."""
    patch = await json_object(request)
    return await curator.patch_view(view_id, lambda attributes: _patched(attributes, patch))


@router.delete(
    "/views/{view_id}", response_model=Deleted, dependencies=[no_parameters], responses=refusals("not-found")
)
async def delete_view(view_id: ViewId, curator: Curates, access: Accesses) -> Deleted:
    """Delete a view and its image."""
    return allowed(await curator.delete_view(view_id), access.may_use)


def _patched(attributes: ViewAttributes, patch: dict[str, Any]) -> ViewAttributes:
    """The attributes after the merge patch; raises InvalidParameters."""
    unknown = [ParameterError(name, "cannot be changed") for name in patch if name not in _KNOWN]
    if not within_depth(patch, METADATA_DEPTH + 1):
        raise InvalidParameters.of("metadata", f"must not be nested deeper than {METADATA_DEPTH} levels")
    document: dict[str, Any] = {
        "place": attributes.place,
        "position": {name: value for name, value in asdict(attributes.position).items() if value is not None},
        "captured_at": None if attributes.captured_at is None else rfc3339(attributes.captured_at),
        "metadata": dict(attributes.metadata),
    }
    merged = merge(document, patch)
    position = merged.pop("position", {})
    if not isinstance(position, dict):
        raise InvalidParameters.of("position", 'needs to be an object such as {"x": 1.5, "y": 2}, or null')
    stray = position.keys() - Position.model_fields.keys()
    unknown += [ParameterError(f"position.{name}", "is unknown") for name in sorted(stray)]
    flat = [name for name in Position.model_fields if name in patch]
    sent = patch.get("position")
    if flat and sent is not None:
        unknown.append(ParameterError(flat[0], "was given beside position: send one or the other"))
    position = merge(position, {name: patch[name] for name in flat})
    known = {name: value for name, value in merged.items() if name in _FIELDS and value is not None}
    located = {name: value for name, value in position.items() if name not in stray}
    try:
        changed = validated(AttributesDocument, {**known, **located}, unknown).attributes()
    except InvalidParameters as error:
        raise InvalidParameters([in_document(one, flat) for one in error.errors]) from None
    return replace(changed, filename=attributes.filename)


def in_document(error: ParameterError, flat: Sequence[str] = ()) -> ParameterError:
    """The mistake, with its path in the view as its name, unless it was sent `flat`."""
    if error.parameter in Position.model_fields and error.parameter not in flat:
        return ParameterError(f"position.{error.parameter}", error.detail)
    return error
