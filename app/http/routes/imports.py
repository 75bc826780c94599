"""`POST /maps/{map}/imports`: enrol the images of a recording."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from python_multipart.multipart import parse_options_header

from app.http.body import announced_bytes
from app.http.dependencies import Curates, MapName, checked
from app.http.import_parameters import ImportParameters
from app.http.notes import note
from app.http.openapi import refusals
from app.http.rate_limits import charge_images
from app.http.started import STARTED, started
from schemas.errors import BadBody
from schemas.wire import Job

router = APIRouter(tags=["maps"], dependencies=checked)

ARCHIVES = ("application/zip", "application/x-zip-compressed")
BAG = "application/x-mcap"
VIDEOS = ("video/mp4", "video/quicktime", "video/webm", "video/x-matroska", "video/x-msvideo")
TYPES = (*ARCHIVES, *VIDEOS, BAG, "application/octet-stream")
"""Names of what is taken; what a body is, its content says."""

_FILE = {"schema": {"type": "string", "format": "binary", "description": "A zip archive of images, a video, or MCAP."}}


@router.post(
    "/maps/{map}/imports",
    status_code=202,
    response_model=Job,
    openapi_extra={"requestBody": {"required": True, "content": dict.fromkeys(TYPES, _FILE)}},
    responses={**STARTED, **refusals("malformed-body", "conflict", "body-too-large", "disk-full")},
)
async def import_recording(
    name: MapName, params: Annotated[ImportParameters, Query()], request: Request, curator: Curates
) -> Response:
    """Enrol the images of a zip archive, a video or a ROS 2 recording, as a job."""
    kind = parse_options_header(request.headers.get("content-type", ""))[0].decode("latin-1")
    if kind not in TYPES:
        sent = f"of the type {kind}" if kind else "without a content type"
        wanted = f"send a zip archive ({ARCHIVES[0]}), a video ({VIDEOS[0]}) or MCAP ({BAG})"
        raise BadBody("malformed-body", f"the body is {sent}; {wanted}")
    job = await curator.import_recording(
        name,
        request.stream(),
        announced_bytes(request.headers),
        lambda images: charge_images(request, images + 1),  # an upload is no image by itself
        params.options(),
    )
    note(job_ids=[job.id])
    return started(job)
