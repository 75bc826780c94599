"""`/snapshots` and `/restore`: maps as files, made while the service works, and maps made from such files."""

from collections.abc import Iterator
from typing import Annotated, Any, BinaryIO

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse

from app.http.body import has_body
from app.http.dependencies import Curates, MapName, SnapshotId, checked, no_parameters
from app.http.keys import Accesses, check_map
from app.http.openapi import answers_bytes, refusals
from app.http.parameters import RestoreParameters
from app.http.receiving import received
from schemas.errors import BadBody
from schemas.wire import Job, RestoredMap, Snapshot, Snapshots

router = APIRouter(tags=["snapshots"], dependencies=checked)

MEDIA_TYPE = "application/x-tar"
CHUNK = 1 << 20

_STARTED: dict[str, Any] = {"headers": {"Location": {"description": "The job.", "schema": {"type": "string"}}}}
_FILE = {"schema": {"type": "string", "format": "binary"}}


@router.post(
    "/maps/{map}/snapshots",
    status_code=202,
    response_model=Job,
    dependencies=[no_parameters],
    responses={202: _STARTED, **refusals("not-found", "conflict", "disk-full")},
)
async def make_snapshot(name: MapName, curator: Curates) -> Response:
    """Make a snapshot of a map in the background: a file of its views, images, descriptions, and what it learned.

    It holds the map as it is when the job begins. `GET /snapshots/{id}` gives it under the id of the job.
    """
    job = await curator.make_snapshot(name)
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": f"/jobs/{job.id}"})


@router.get("/snapshots", response_model=Snapshots, dependencies=[no_parameters], responses=refusals())
async def list_snapshots(curator: Curates, access: Accesses) -> Snapshots:
    """All snapshots that this service keeps, newest first."""
    kept = await curator.snapshots()
    return Snapshots(snapshots=[one for one in kept.snapshots if access.may_use(one.map)])


@router.get(
    "/snapshots/{snapshot_id}",
    response_class=Response,
    dependencies=[no_parameters],
    responses={
        **answers_bytes(MEDIA_TYPE, description="The file, a tar: `POST /restore` takes it."),
        **refusals("not-found"),
    },
)
async def get_snapshot(snapshot_id: SnapshotId, curator: Curates) -> Response:
    """The file of a snapshot, streamed."""
    facts, file = await curator.open_snapshot(snapshot_id)
    name = f"{facts.map}-{facts.created_at:%Y%m%dT%H%M%SZ}.snapshot"
    headers = {"Content-Length": str(facts.bytes), "Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(_chunks(file), media_type=MEDIA_TYPE, headers=headers)


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


def _chunks(file: BinaryIO) -> Iterator[bytes]:
    with file:
        while chunk := file.read(CHUNK):
            yield chunk
