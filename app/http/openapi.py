"""Corrects FastAPI's OpenAPI document: parameters from their models, bodies, problems, examples."""

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from app.http import problems
from app.http.examples import PROBLEM_DETAILS
from app.http.parameters import METADATA_FILTER
from app.http.scopes import OPEN_PATHS, ROUTES
from app.http.validation import Parameters
from schemas.requests import PatchMap, PostCalibration, PostProposal, PostRecipe, PostUnknown, PutMap
from schemas.wire import Problem

Json = dict[str, Any]

_REF = "#/components/schemas/"
_IMAGE_TYPES = (
    "image/jpeg",
    "image/png",
    "image/webp",
    "image/bmp",
    "image/tiff",
    "image/heic",
    "image/heif",
    "application/octet-stream",
)
_EVERYWHERE = ("bad-request", "request-timeout", "invalid-parameter", "headers-too-large", "internal")
_SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "A key from `./revisit keys create`."},
    "header": {"type": "apiKey", "in": "header", "name": "X-Api-Key", "description": "The same key."},
}

DESCRIPTION = """Have I been here before, and where is here? Enrol photos of places; later query with a photo.

Send images as the multipart part `image`, or as the raw body with their content type; parameters are multipart
parts or query parameters, by the same names. Unknown and repeated parameters are errors, and so is a body where none
is taken. Every error is `application/problem+json`. Every answer carries `X-Request-Id`.

A service that has keys asks for one on every route but `/livez`, `/readyz`, `/version` and the console at `/`: as
`Authorization: Bearer KEY` or `X-Api-Key: KEY`. The roles of a route's security are the scope that its key needs:
read, write or admin, each with those before it."""


OF_IMAGES = (
    "body-too-large",
    "not-a-picture",
    "undecodable-picture",
    "picture-too-large",
    "picture-too-small",
    "nothing-static",
)
"""Problems of an image that was sent."""


def refusals(*codes: str, always_open: bool = False) -> dict[int | str, Json]:
    """The `responses` of a route: these problems, and those of every route.

    Parameters
    ----------
    *codes : str
        Keys of `app.http.problems.KINDS`.
    always_open : bool
        The route answers while the service starts and stops.
    """
    return _answers(*codes, *_EVERYWHERE, *(() if always_open else ("unavailable",)))


def _answers(*codes: str) -> dict[int | str, Json]:
    """The `responses` for problems."""
    by_status: dict[int | str, Json] = {}
    for code in dict.fromkeys(codes):
        _add_refusal(by_status, code)
    return by_status


def _add_refusal(by_status: dict[Any, Json], code: str, key: type[int] | type[str] = int) -> None:
    """Add a problem to the `responses` of a route; `key`: type of the statuses in them."""
    kind = problems.KINDS[code]
    entry = by_status.setdefault(
        key(kind.status),
        {
            "description": "",
            "content": {problems.MEDIA_TYPE: {"schema": {"$ref": _REF + "Problem"}, "examples": {}}},
        },
    )
    entry["description"] = ". ".join(filter(None, (entry["description"], f"`{code}`: {kind.title}")))
    entry["content"][problems.MEDIA_TYPE]["examples"][code] = {"value": _example(code)}
    if kind.status == 401:
        entry["headers"] = {"WWW-Authenticate": {"schema": {"type": "string"}, "required": True}}
    if kind.status == 416:
        entry["headers"] = {"Content-Range": {"schema": {"type": "string"}, "required": True}}
    if kind.status in (429, 503):
        entry["headers"] = {
            "Retry-After": {"description": "Seconds to wait.", "schema": {"type": "integer"}, "required": True}
        }


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


def takes_images(model: type[Parameters], *, several: bool, headers: list[Json] | None = None) -> Json:
    """`openapi_extra` of a route that takes images, as multipart or as the raw body.

    Each parameter may be a part or stand in the URL; FastAPI can document only one of the two.
    """
    single: Json = {"type": "string", "format": "binary", "description": "JPEG, PNG, WebP, BMP, TIFF or HEIC."}
    image: Json = {"type": "array", "items": single, "minItems": 1} if several else single
    fields = _fields(model)
    in_url = [{"name": name, "in": "query", "schema": schema} for name, schema in fields.items()]
    filters = fields.pop(METADATA_FILTER, None)
    form = {
        "type": "object",
        "required": ["image"],
        "properties": {"image": image, **fields},
        "additionalProperties": False,
        **({"patternProperties": {r"^metadata\..+": filters}} if filters else {}),
    }
    raw = {"schema": {"type": "string", "format": "binary"}}
    return {
        "parameters": [*in_url, *(headers or [])],
        "requestBody": {
            "required": True,
            "content": {"multipart/form-data": {"schema": form}, **dict.fromkeys(_IMAGE_TYPES, raw)},
        },
    }


def takes_json(
    schema: Json, *, media_types: tuple[str, ...] = ("application/json",), required: bool = False, example: Json
) -> Json:
    """`openapi_extra` of a route that takes JSON."""
    content = {"schema": schema, "example": example}
    return {"requestBody": {"required": required, "content": dict.fromkeys(media_types, content)}}


def takes_map(model: type[PutMap] = PutMap, **example: Any) -> Json:
    """`openapi_extra` of the routes that take a recipe; `example`: further fields of the model's example."""
    recipe = {"labels": ["building", "tree", "road", "car"], "dynamic": ["car"], "preset": "default"}
    return takes_json({"$ref": _REF + model.__name__}, example={**recipe, **example})


DRAWN_BY = "Revisit-Drawn-By"
"""Header of drawings: the network whose labels they show."""


def answers_bytes(
    *media_types: str, description: str, etag: bool = False, drawn: bool = False
) -> dict[int | str, Json]:
    """The `responses` of a route that answers an image or text; `drawn` by a network that a header names."""
    content = {kind: {"schema": {"type": "string", "format": "binary"}} for kind in media_types}
    responses: dict[int | str, Json] = {200: {"description": description, "content": content}}
    if etag:
        responses[200]["headers"] = {"ETag": {"schema": {"type": "string"}, "required": True}}
        responses[304] = {"description": "The caller's copy (`If-None-Match`) is current."}
    if drawn:
        responses[200].setdefault("headers", {})[DRAWN_BY] = {
            "description": "The network whose labels are shown. The method compares those of the encoder; a segmenter, "
            "where the encoder has one, is finer.",
            "schema": {"type": "string", "enum": ["encoder", "segmenter"]},
            "required": True,
        }
    return responses


def _fields(model: type[Parameters]) -> dict[str, Json]:
    """The schema of each parameter of a model."""
    schemas: dict[str, Json] = model.model_json_schema()["properties"]
    return {name: _plain(schema) for name, schema in schemas.items()}


def _plain(schema: Json) -> Json:
    """A schema without title, null and empty defaults: parameters are text and cannot be null."""
    plain = {key: value for key, value in schema.items() if key != "title"}
    branches = [b for b in plain.pop("anyOf", []) if b != {"type": "null"}]
    if branches:
        plain = {**branches[0], **plain}
    if plain.get("default", 0) in (None, [], {}):
        del plain["default"]
    return plain


def _described(parameter: Json) -> Json:
    """A parameter object with a plain schema; the description stands beside the schema."""
    schema = _plain(parameter["schema"])
    description = schema.pop("description", None) or parameter["description"]
    return {"required": False, **parameter, "description": description, "schema": schema}


def document(app: FastAPI) -> Json:
    """The OpenAPI document of the application; made once."""
    if app.openapi_schema is None:
        whole = get_openapi(
            title=app.title, version=app.version, description=DESCRIPTION, routes=app.routes, tags=app.openapi_tags
        )
        schemas = whole.setdefault("components", {}).setdefault("schemas", {})
        for model in (
            Problem,
            problems.OscpProblem,
            problems.CompreFaceProblem,
            PutMap,
            PostRecipe,
            PatchMap,
            PostCalibration,
            PostUnknown,
            PostProposal,
        ):
            schemas.update(_definitions(model))
        whole["components"]["securitySchemes"] = _SCHEMES
        for method, path, operation in (
            (method, path, one) for path, methods in whole["paths"].items() for method, one in methods.items()
        ):
            _secure(operation, method.upper(), path)
            if "requestBody" not in operation:
                _add_refusal(operation["responses"], "unexpected-body", str)
            _reshape(operation, problems.shape_of(path))
            if "parameters" in operation:
                operation["parameters"] = [_described(parameter) for parameter in operation["parameters"]]
        # FastAPI's own validation errors are never sent.
        schemas.pop("HTTPValidationError", None)
        schemas.pop("ValidationError", None)
        app.openapi_schema = whole
    return app.openapi_schema


def _secure(operation: Json, method: str, path: str) -> None:
    """Say which key a route asks for, and what it answers without; ``{}``: none, of a service without keys."""
    if path in OPEN_PATHS:
        operation["security"] = []
        return
    scope = ROUTES.get((method, path), "admin")
    operation["security"] = [{"bearer": [scope]}, {"header": [scope]}, {}]
    responses = operation["responses"]
    for code in ("unauthorized", "forbidden", "other-site", "too-many-requests"):
        told = responses.get(str(problems.KINDS[code].status))
        if told is None or code not in told["content"][problems.MEDIA_TYPE]["examples"]:
            _add_refusal(responses, code, str)


def _reshape(operation: Json, shape: type[Problem]) -> None:
    """Say of which shape the problems of a route are."""
    if shape is Problem:
        return
    told = [response.get("content", {}).get(problems.MEDIA_TYPE) for response in operation["responses"].values()]
    for content in filter(None, told):
        content["schema"] = {"$ref": _REF + shape.__name__}
        content["examples"] = {
            code: {"value": example["value"] | problems.own_members(shape, example["value"]["detail"])}
            for code, example in content["examples"].items()
        }


def _definitions(model: type[BaseModel]) -> Json:
    mode: Any = "serialization" if issubclass(model, Problem) else "validation"
    schema = model.model_json_schema(mode=mode, ref_template=_REF + "{model}")
    return {**schema.pop("$defs", {}), model.__name__: schema}
