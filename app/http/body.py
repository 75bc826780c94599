"""Parses the body of a request: images with their parameters, or JSON."""

import asyncio
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote_to_bytes

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import Scope

from schemas.errors import BadBody, BadImage, BodyTooLarge, InvalidParameters, ParameterError, UnexpectedBody, echoed
from schemas.values import file_name, strict_json

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

IMAGE_PART = "image"

MOST_IMAGES = 100
MOST_PARAMETERS = 200
LONGEST_PARAMETER = 64 * 1024
LARGEST_JSON = 256 * 1024
MOST_JSON_VALUES = 200_000
"""In a body larger than `LARGEST_JSON`, which is large for its one image. This many values are parsed in a tenth of a
second and take 20 MB."""

_QUICK = 1_000_000  # bytes that are parsed within a few milliseconds

_EXTENDED_NAME = re.compile(rb";\s*filename\*\s*=\s*utf-8'[^']*'([^\s;\"]+)", re.IGNORECASE)
"""The file name of a part as RFC 8187 writes it. .NET sends a name that is not ASCII in this form, and a second time as
``filename="=?utf-8?B?...?="``."""

_PART = re.compile(rb"\r\n(?i:content-disposition)[ \t]*:[ \t]*form-data")
"""The header that each part has, whatever the boundary. The bytes of an image do not contain it."""

_AS_IT_IS = (b"", b"7bit", b"8bit", b"binary")
"""Transfer encodings that leave a part unchanged (RFC 2045, 6.2). RFC 7578, 4.7 rules out the others over HTTP."""

_RAW_TYPES = ("application/octet-stream", "binary/octet-stream")


def _remedy(named: str) -> str:
    return f"send the image as the multipart part `{named}`, or as the body with content-type image/jpeg"


@dataclass(frozen=True)
class Sent:
    """A parsed request with images.

    Parameters
    ----------
    images : sequence of (file name or None, bytes)
        In the order of the body; at least one, none of 0 bytes.
    parameters : sequence of (name, value)
        Those of the URL, then those of the body.
    errors : sequence of ParameterError
        Mistakes in the multipart parts, to be reported together with those in the parameters' values.
    """

    images: Sequence[tuple[str | None, bytes]]
    parameters: Sequence[tuple[str, str]]
    errors: Sequence[ParameterError] = ()


def has_body(scope: Scope) -> bool:
    """Whether a request announces a body, which may turn out to be empty when it is chunked (RFC 9112, section 6)."""
    headers = Headers(scope=scope)
    return headers.get("content-length", "0").strip("0") != "" or "transfer-encoding" in headers


def announced_bytes(headers: Headers) -> int:
    """How long a request says that its body is; 0 where it does not say."""
    announced = headers.get("content-length", "")
    return int(announced) if announced.isdigit() else 0


async def refuse_body(request: Request) -> None:
    """Raise UnexpectedBody when a request has a body that is not empty; reads it no further than its first bytes."""
    if not has_body(request.scope):
        return
    size = request.headers.get("content-length")
    if size is None:
        async for chunk in request.stream():
            if chunk:
                break
        else:
            return
    sent = f"one of {int(size):,} bytes" if size else "one"
    raise UnexpectedBody(f"{request.method} {echoed(request.url.path)} takes no body, and {sent} was sent")


async def take(request: Request, named: str = IMAGE_PART) -> Sent:
    """Parse a request with images, multipart (RFC 7578) with parts of this name or one image as the raw body.

    Raises
    ------
    BadBody
        ``no-picture`` or ``malformed-body``.
    BadImage
        ``not-a-picture``: the content type is neither multipart/form-data nor an image type.
    BodyTooLarge
        Raised by `app.http.middleware.BodyLimit` while the body is read.
    InvalidParameters
        No part has the name of images, and other parts cannot be used.
    """
    content_type = request.headers.get("content-type", "")
    body = b"".join([chunk async for chunk in request.stream()])  # `request.body()` would keep it beside the images
    in_url = list(request.query_params.multi_items())
    kind, options = parse_options_header(content_type)
    if kind == b"multipart/form-data":
        boundary = options.get(b"boundary", b"")
        if len(body) <= _QUICK:
            return _multipart(body, boundary, in_url, named)
        # Milliseconds for a photo, but a body made of near-boundaries takes long and must not block the event loop.
        return await asyncio.to_thread(_multipart, body, boundary, in_url, named)
    if not body:
        raise BadBody("no-picture", f"the body is empty; {_remedy(named)}")
    name = kind.decode("latin-1")
    if name and not name.startswith("image/") and name not in _RAW_TYPES:
        raise BadImage("not-a-picture", f"the content type is {echoed(name)}; {_remedy(named)}")
    return Sent([(None, body)], in_url)


async def json_object(request: Request, largest: int = LARGEST_JSON) -> dict[str, Any]:
    """The body as a JSON object; {} when the body is empty.

    Raises
    ------
    BadBody
        ``malformed-body``: not JSON, not an object, or of more than `MOST_JSON_VALUES` values.
    BodyTooLarge
        The body has more than `largest` bytes.
    """
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > largest:
            raise BodyTooLarge(f"the body has more than {largest:,} bytes, the most that this request may have")
    if not body.strip():
        return {}
    if len(body) > LARGEST_JSON and sum(map(body.count, (b",", b"[", b"{"))) > MOST_JSON_VALUES:
        raise BadBody("malformed-body", f"the body has more than {MOST_JSON_VALUES:,} values")
    try:
        # The event loop has other callers than whoever sends megabytes.
        value = await asyncio.to_thread(strict_json, bytes(body)) if len(body) > _QUICK else strict_json(bytes(body))
    except ValueError as error:
        raise BadBody("malformed-body", f"the body {error}") from None
    if not isinstance(value, dict):
        raise BadBody("malformed-body", "the body needs to be a JSON object")
    return value


@dataclass
class _Part:
    """One part of a multipart body while it is read."""

    headers: dict[str, bytes] = field(default_factory=dict)
    pieces: list[bytes] = field(default_factory=list)
    header_name: bytes = b""
    header_value: bytes = b""

    @property
    def content(self) -> bytes:
        return b"".join(self.pieces)

    def names(self) -> tuple[str, str | None]:
        """(name, file name or None) of the part's Content-Disposition (RFC 7578, 4.2); raises BadBody without one, and
        of a part that would have to be decoded."""
        kind, options = parse_options_header(self.headers.get("content-disposition"))
        if kind != b"form-data" or b"name" not in options:
            raise BadBody("malformed-body", "a part of the multipart body has no Content-Disposition with a name")
        name, coding = _utf8(options[b"name"]), self.headers.get("content-transfer-encoding", b"").strip()
        if coding.lower() not in _AS_IT_IS:
            said = f"Content-Transfer-Encoding: {echoed(coding.decode('latin-1'))}"
            detail = f"the part `{echoed(name)}` is encoded ({said}); send it as it is, without that header"
            raise BadBody("malformed-body", detail)
        extended = _EXTENDED_NAME.search(self.headers["content-disposition"])
        file = unquote_to_bytes(extended[1]) if extended else options.get(b"filename")
        return name, None if file is None else _utf8(file)


class _Reader:
    """Collects parts from python-multipart's callbacks.

    Starlette's form parser accepts a truncated body as complete, and spools images to files although the size of the
    body is bounded already.
    """

    def __init__(self) -> None:
        self.parts: list[_Part] = []
        self.ended = False

    def callbacks(self) -> "MultipartCallbacks":
        return {
            "on_part_begin": self._begin,
            "on_header_field": self._header_name,
            "on_header_value": self._header_value,
            "on_header_end": self._header_end,
            "on_part_data": self._data,
            "on_end": self._end,
        }

    def _begin(self) -> None:
        if len(self.parts) >= MOST_IMAGES + MOST_PARAMETERS:
            raise BadBody("malformed-body", f"the body has more than {len(self.parts)} parts")
        self.parts.append(_Part())

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self.parts[-1].header_name += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self.parts[-1].header_value += data[start:end]

    def _header_end(self) -> None:
        part = self.parts[-1]
        part.headers[part.header_name.decode("latin-1").lower()] = part.header_value
        part.header_name = part.header_value = b""

    def _data(self, data: bytes, start: int, end: int) -> None:
        self.parts[-1].pieces.append(data[start:end])

    def _end(self) -> None:
        self.ended = True


def _multipart(body: bytes, boundary: bytes, in_url: list[tuple[str, str]], named: str) -> Sent:
    if not boundary:
        raise BadBody("malformed-body", "the content type names no boundary; let your HTTP library write the header")
    if not body:
        raise BadBody("no-picture", f"the body is empty; {_remedy(named)}")
    images: list[tuple[str | None, bytes]] = []
    attributes: list[tuple[str, str]] = []
    errors: list[ParameterError] = []
    for part in _parts(body, boundary):
        name, file = part.names()
        content = part.content
        if name == named:
            if not content:
                raise BadBody("no-picture", f"the part `{named}` number {len(images) + 1} is empty")
            images.append((file_name(file), content))
        elif file is not None:
            errors.append(ParameterError(name, f"is a file; images are sent as parts named {named}"))
        elif len(content) > LONGEST_PARAMETER:
            errors.append(ParameterError(name, f"has {len(content)} bytes; at most {LONGEST_PARAMETER} are taken"))
        else:
            try:
                attributes.append((name, content.decode()))
            except UnicodeDecodeError:
                errors.append(ParameterError(name, "is not UTF-8"))
    if not images:
        # Most likely the image was sent under another name: report that part rather than a missing image.
        if errors:
            raise InvalidParameters(errors)
        raise BadBody("no-picture", f"no part is named {named}; {_remedy(named)}")
    if len(images) > MOST_IMAGES:
        errors.append(ParameterError(named, f"{len(images)} images; at most {MOST_IMAGES} at once"))
    twice = {name for name, _ in in_url} & {name for name, _ in attributes}
    errors += [ParameterError(name, "was given both in the URL and in the body") for name in sorted(twice)]
    return Sent(images, [p for p in in_url if p[0] not in twice] + attributes, errors)


def _parts(body: bytes, boundary: bytes) -> list[_Part]:
    reader = _Reader()
    opening = b"--" + boundary
    # What stands before the first boundary says nothing (RFC 2046, 5.1.1).
    first = 0 if body.startswith(opening) else max(0, body.find(b"\r\n" + opening))
    try:
        parser = MultipartParser(boundary, reader.callbacks())
        parser.write(body[first:])
        parser.finalize()
    except FormParserError as error:
        raise BadBody("malformed-body", f"the multipart body is malformed: {error}") from None
    if not reader.ended:
        raise BadBody("malformed-body", "the multipart body breaks off before its closing boundary")
    begun = len(_PART.findall(body))
    if begun > len(reader.parts):
        raise BadBody(
            "malformed-body",
            f"the multipart body has {begun} parts, but boundaries before {len(reader.parts)} of them: one is damaged",
        )
    return reader.parts


def _utf8(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace")
