"""`/snapshots` and `/restore`: maps as files, made while the service works, and maps made from such files."""

import asyncio
import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Annotated, Any, BinaryIO

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from app.http.body import has_body
from app.http.conditional import is_fresh, quoted
from app.http.dependencies import Curates, MapName, SnapshotId, checked, no_parameters
from app.http.keys import Accesses, check_map
from app.http.openapi import answers_bytes, refusals
from app.http.parameters import RestoreParameters
from app.http.ranges import wanted
from app.http.receiving import received
from app.http.started import STARTED, started
from schemas.errors import BadBody, NotFound
from schemas.wire import Job, RestoredMap, Snapshot, Snapshots

router = APIRouter(tags=["snapshots"], dependencies=checked)

MEDIA_TYPE = "application/x-tar"
CHUNK = 1 << 20

END = 2048
"""Bytes at the end of a snapshot, in which the SHA-256 of all that is before them stands."""

_FILE = {"schema": {"type": "string", "format": "binary"}}
_TEXT = {"schema": {"type": "string"}}
_PART: dict[str, Any] = {
    "description": "The part that `Range` asks for.",
    "content": {MEDIA_TYPE: _FILE},
    "headers": {name: {**_TEXT, "required": True} for name in ("Content-Range", "ETag")},
}
_RANGES = [
    {
        "name": "Range",
        "in": "header",
        "description": "One part, such as `bytes=1000-` for what is behind the first 1000 bytes; of several parts, all "
        "is answered.",
        **_TEXT,
    },
    {
        "name": "If-Range",
        "in": "header",
        "description": "The ETag of the answer that broke off: all is answered where it is another file's.",
        **_TEXT,
    },
]


@router.post(
    "/maps/{map}/snapshots",
    status_code=202,
    response_model=Job,
    dependencies=[no_parameters],
    responses={**STARTED, **refusals("not-found", "conflict", "disk-full")},
)
async def make_snapshot(name: MapName, curator: Curates) -> Response:
    """Make a snapshot of a map in the background: a file of its views, images, descriptions, and what it learned.

    It holds the map as it is when the job begins. `GET /snapshots/{id}` gives it under the id of the job.
    """
    return started(await curator.make_snapshot(name))


@router.get("/snapshots", response_model=Snapshots, dependencies=[no_parameters], responses=refusals())
async def list_snapshots(curator: Curates, access: Accesses) -> Snapshots:
    """All snapshots that this service keeps, newest first."""
    kept = await curator.snapshots()
    return Snapshots(snapshots=[one for one in kept.snapshots if access.may_use(one.map)])


@router.get(
    "/snapshots/{snapshot_id}",
    response_class=Response,
    dependencies=[no_parameters],
    openapi_extra={"parameters": _RANGES},
    responses={
        **answers_bytes(MEDIA_TYPE, description="The file, a tar: `POST /restore` takes it.", etag=True),
        206: _PART,
        **refusals("not-found", "range-not-satisfiable"),
    },
)
async def get_snapshot(snapshot_id: SnapshotId, request: Request, curator: Curates) -> Response:
    """The file of a snapshot, streamed; or a part of it, so that a download goes on where its connection broke."""
    facts, file = await curator.open_snapshot(snapshot_id)
    with ExitStack() as unless_sent:
        unless_sent.callback(file.close)
        try:
            size, etag = await asyncio.to_thread(_size_and_etag, file)
        except FileNotFoundError:  # of an object store, since it was opened
            raise NotFound("snapshot", snapshot_id) from None
        headers = {"ETag": quoted(etag), "Accept-Ranges": "bytes"}
        if is_fresh(request, etag):
            return Response(status_code=304, headers=headers)
        part = wanted(request, size, etag)
        name = f"{facts.map}-{facts.created_at:%Y%m%dT%H%M%SZ}.snapshot"
        headers["Content-Disposition"] = f'attachment; filename="{name}"'
        if part is not None:
            headers["Content-Range"] = f"bytes {part.start}-{part.stop - 1}/{size}"
        status, part = (200, range(size)) if part is None else (206, part)
        headers["Content-Length"] = str(len(part))
        unless_sent.pop_all()
        return _Download(file, part, status, headers)


@router.delete(
    "/snapshots/{snapshot_id}",
    response_model=Snapshot,
    dependencies=[no_parameters],
    responses=refusals("not-found"),
)
async def delete_snapshot(snapshot_id: SnapshotId, curator: Curates) -> Snapshot:
    """Remove a snapshot; the answer is what it was."""
    return await curator.delete_snapshot(snapshot_id)


@router.post(
    "/restore",
    status_code=201,
    response_model=RestoredMap,
    openapi_extra={
        "requestBody": {
            "required": True,
            "description": "The file of a snapshot, as the raw body; of any size that the disk has room for.",
            "content": {MEDIA_TYPE: _FILE, "application/octet-stream": _FILE},
        }
    },
    responses=refusals("malformed-body", "conflict", "body-too-large", "disk-full"),
)
async def restore(
    params: Annotated[RestoreParameters, Query()], request: Request, curator: Curates, access: Accesses
) -> RestoredMap:
    """Make a map from a snapshot, by this service or another one; it gives the same answers as the map did.

    The whole file is verified before anything is stored, and the map appears at once or not at all.
    """
    check_map(access, params.as_)
    if not has_body(request.scope):
        raise BadBody("malformed-body", "the body is empty; send the file of a snapshot as the body")
    async with received(request, curator) as path:
        return await curator.restore(path, params.as_, lambda name: check_map(access, name))


def _size_and_etag(file: BinaryIO) -> tuple[int, str]:
    """Bytes of a snapshot, and what tells it from one that was made anew under the same id."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - END))
    return size, hashlib.sha256(file.read(END)).hexdigest()[:32]


class _Download(StreamingResponse):
    """A part of an open file, which is closed at the end, however that comes: HEAD and callers who go away end it."""

    def __init__(self, file: BinaryIO, part: range, status: int, headers: dict[str, str]) -> None:
        super().__init__(_chunks(file, part), status, headers, MEDIA_TYPE)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._file.close()


def _chunks(file: BinaryIO, part: range) -> Iterator[bytes]:
    file.seek(part.start)
    left = len(part)
    while left and (chunk := file.read(min(CHUNK, left))):
        left -= len(chunk)
        yield chunk
