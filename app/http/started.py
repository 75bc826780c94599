"""The answer to a call that begins a job."""

from typing import Any

from fastapi.responses import JSONResponse, Response

from schemas.wire import Job

STARTED: dict[int | str, dict[str, Any]] = {
    202: {"headers": {"Location": {"description": "The job.", "schema": {"type": "string"}}}}
}
"""What the OpenAPI document says of it."""


def started(job: Job) -> Response:
    """The job, and where it is."""
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": f"/jobs/{job.id}"})
