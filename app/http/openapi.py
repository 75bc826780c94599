"""The OpenAPI document says what is really sent: parameters from their models, bodies, problems, examples."""

from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from app.http import problems
from app.http.examples import PROBLEM_DETAILS
from app.http.parameters import Parameters
from schemas.requests import PatchMap, PutMap
from schemas.wire import Problem

Json = dict[str, Any]

_REF = "#/components/schemas/"
_IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp", "image/bmp", "image/tiff", "application/octet-stream")
_EVERYWHERE = ("invalid-parameter", "internal")

DESCRIPTION = """Have I been here before, and where is here? Enrol photos of places; later ask with a photo.

Send pictures as the multipart part `image`, or as the raw body with their content type; parameters are multipart
parts or query parameters, by the same names. Unknown parameters are errors. Every error is `application/problem+json`.
Every answer carries `X-Request-Id`."""


def refusals(*codes: str, always_open: bool = False) -> dict[int | str, Json]:
    """The `responses` of a route that may answer these problems, besides those that every route may.

    Parameters
    ----------
    always_open : bool
        The route answers while the service starts and stops.
    """
    by_status: dict[int | str, Json] = {}
    for code in dict.fromkeys((*codes, *_EVERYWHERE, *(() if always_open else ("unavailable",)))):
        kind = problems.KINDS[code]
        entry = by_status.setdefault(
            kind.status,
            {
                "description": "",
                "content": {problems.MEDIA_TYPE: {"schema": {"$ref": _REF + "Problem"}, "examples": {}}},
            },
        )
        entry["description"] = ". ".join(filter(None, (entry["description"], f"`{code}`: {kind.title}")))
        entry["content"][problems.MEDIA_TYPE]["examples"][code] = {"value": _example(code)}
        if kind.status in (429, 503):
            entry["headers"] = {
                "Retry-After": {"description": "Seconds to wait.", "schema": {"type": "integer"}, "required": True}
            }
    return by_status


def _example(code: str) -> Json:
    kind = problems.KINDS[code]
    detail = PROBLEM_DETAILS[code]
    parameter, _, text = detail.partition(": ")
    return {
        "type": problems.URN + code,
        "title": kind.title,
        "status": kind.status,
        "detail": detail,
        "errors": [{"parameter": parameter, "detail": text}] if code == "invalid-parameter" else [],
        "request_id": "b6f0c2e19f1d4a6f8d0e3a7c5b2f1e90",
    }


def parameters(model: type[Parameters]) -> list[Json]:
    """The query parameters that a model reads."""
    described = [
        {"name": name, "in": "query", "required": name in required, **_split(schema)}
        for (name, schema), required in _properties(model)
    ]
    if model.takes_metadata_filters:
        described.append(
            {
                "name": "metadata.KEY",
                "in": "query",
                "required": False,
                "description": "Views whose metadata has VALUE under KEY, as text; may be given for several keys.",
                "schema": {"type": "string"},
            }
        )
    return described


def asks(model: type[Parameters]) -> Json:
    """`openapi_extra` of a route with query parameters."""
    return {"parameters": parameters(model)}


def asks_images(model: type[Parameters], *, several: bool, headers: list[Json] | None = None) -> Json:
    """`openapi_extra` of a route that takes pictures, as multipart or as the raw body."""
    single: Json = {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP, BMP or TIFF."}
    image: Json = {"type": "array", "items": single, "minItems": 1} if several else single
    parts: Json = {"image": image}
    for (name, schema), _ in _properties(model):
        parts[name] = schema
    pattern = {"patternProperties": {r"^metadata\..+": {"type": "string"}}} if model.takes_metadata_filters else {}
    form = {"type": "object", "required": ["image"], "properties": parts, "additionalProperties": False, **pattern}
    raw = {"schema": {"type": "string", "format": "binary"}}
    return {
        "parameters": [*parameters(model), *(headers or [])],
        "requestBody": {
            "required": True,
            "content": {"multipart/form-data": {"schema": form}, **dict.fromkeys(_IMAGE_TYPES, raw)},
        },
    }


def takes_json(schema: Json, *, media_types: tuple[str, ...] = ("application/json",), example: Json) -> Json:
    """`openapi_extra` of a route that takes JSON."""
    content = {"schema": schema, "example": example}
    return {"requestBody": {"required": False, "content": dict.fromkeys(media_types, content)}}


def takes_map() -> Json:
    """`openapi_extra` of the routes that take a `PutMap`."""
    example = {"labels": ["building", "tree", "road", "car"], "dynamic": ["car"], "preset": "default"}
    return takes_json({"$ref": _REF + "PutMap"}, example=example)


def answers_bytes(*media_types: str, description: str, etag: bool = False) -> dict[int | str, Json]:
    """The `responses` of a route that answers a picture or text."""
    content = {kind: {"schema": {"type": "string", "format": "binary"}} for kind in media_types}
    responses: dict[int | str, Json] = {200: {"description": description, "content": content}}
    if etag:
        responses[200]["headers"] = {"ETag": {"schema": {"type": "string"}, "required": True}}
        responses[304] = {"description": "The caller's copy (`If-None-Match`) is still right."}
    return responses


def _properties(model: type[Parameters]) -> list[tuple[tuple[str, Json], set[str]]]:
    """((name, schema), required names) of each parameter a client can give."""
    schema = model.model_json_schema()
    required = set(schema.get("required", ()))
    return [((name, _plain(s)), required) for name, s in schema["properties"].items() if not s.get("hidden")]


def _plain(schema: Mapping[str, Any]) -> Json:
    """Without what text on the wire cannot be: null."""
    plain = {key: value for key, value in schema.items() if key != "title"}
    branches = [b for b in plain.pop("anyOf", []) if b != {"type": "null"}]
    if branches:
        plain = {**branches[0], **plain}
    if plain.get("default", 0) is None or plain.get("default") == [] or plain.get("default") == {}:
        del plain["default"]
    return plain


def _split(schema: Json) -> Json:
    """A schema as OpenAPI's parameter object has it, with the description outside."""
    rest = {key: value for key, value in schema.items() if key != "description"}
    return {"description": schema.get("description", ""), "schema": rest}


def document(app: FastAPI) -> Json:
    """The whole document; made once."""
    if app.openapi_schema is None:
        whole = get_openapi(
            title=app.title, version=app.version, description=DESCRIPTION, routes=app.routes, tags=app.openapi_tags
        )
        schemas = whole.setdefault("components", {}).setdefault("schemas", {})
        for model in (Problem, PutMap, PatchMap):
            schemas.update(_definitions(model))
        # FastAPI's own shape of validation errors is never sent.
        schemas.pop("HTTPValidationError", None)
        schemas.pop("ValidationError", None)
        app.openapi_schema = whole
    return app.openapi_schema


def _definitions(model: type[BaseModel]) -> Json:
    mode: Any = "validation" if model in (PutMap, PatchMap) else "serialization"
    schema = model.model_json_schema(mode=mode, ref_template=_REF + "{model}")
    return {**schema.pop("$defs", {}), model.__name__: schema}
