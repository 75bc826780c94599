"""`/jobs`: work in the background."""

from typing import Annotated

from fastapi import APIRouter, Query
from fastapi.responses import Response
from fastapi.sse import EventSourceResponse

from app.http.dependencies import Curates, Follows, JobId, Lifecycles, checked, no_parameters
from app.http.job_events import job_events
from app.http.keys import Accesses, ChecksAgain, check_map
from app.http.openapi import refusals
from app.http.parameters import ListJobs
from schemas.errors import Forbidden
from schemas.wire import Job, Jobs

router = APIRouter(tags=["jobs"], dependencies=checked)

EVENT = {
    "type": "object",
    "required": ["event", "data"],
    "properties": {
        "event": {"const": "job"},
        "data": {
            "type": "string",
            "description": "The job as `GET /jobs/{job_id}` answers it.",
            "contentMediaType": "application/json",
            "contentSchema": {"$ref": "#/components/schemas/Job"},
        },
        "retry": {"type": "integer"},
    },
}
"""One event of a job: 3.1 has no `itemSchema` for streams, as 3.2 has, and readers take `schema` for that of each."""

OF_WRITERS = frozenset({"describe", "import"})
"""Kinds of jobs that the scope `write` begins, and so may cancel."""


@router.get("/jobs", response_model=Jobs, responses=refusals("not-found"))
async def list_jobs(params: Annotated[ListJobs, Query()], curator: Curates, access: Accesses) -> Jobs:
    """A page of jobs, newest first."""
    check_map(access, params.map)
    return await curator.jobs(
        params.map,
        kinds=params.kinds,
        state=params.state,
        cursor=params.cursor,
        limit=params.limit,
        among=access.maps,
    )


@router.get("/jobs/{job_id}", response_model=Job, dependencies=[no_parameters], responses=refusals("not-found"))
async def get_job(job_id: JobId, curator: Curates) -> Job:
    """One job: kind, state, progress, result or failure."""
    return await curator.job(job_id)


@router.get(
    "/jobs/{job_id}/events",
    response_class=Response,
    dependencies=[no_parameters],
    responses={
        200: {
            "description": "Server-sent events named `job`, whose data is the job as `GET /jobs/{job_id}` answers it.",
            "content": {EventSourceResponse.media_type: {"schema": EVENT}},
        },
        **refusals("not-found"),
    },
)
async def follow_job(
    job_id: JobId, curator: Curates, lifecycle: Lifecycles, followers: Follows, check_again: ChecksAgain
) -> Response:
    """The job now, then again whenever its state or progress changes; ends when the job has ended.

    The stream also ends when the service stops, or the key no longer does, and at once where many follow jobs: connect
    again.
    """

    async def look() -> Job:
        await check_again()
        return await curator.job(job_id)

    events = job_events(await curator.job(job_id), look, lambda: lifecycle.draining, followers)
    # Proxies such as nginx would hold events back until they fill a buffer.
    return EventSourceResponse(events, headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"})


@router.delete(
    "/jobs/{job_id}",
    response_model=Job,
    dependencies=[no_parameters],
    responses=refusals("not-found", "conflict"),
)
async def cancel_job(job_id: JobId, curator: Curates, access: Accesses) -> Job:
    """Cancel a describe job that is waiting, or a job of another kind that has not finished.

    The scope `write` cancels describe and import jobs, which it begins; the others need `admin`.
    """
    kind = (await curator.job(job_id)).kind
    if kind not in OF_WRITERS and not access.may("admin"):
        raise Forbidden(f"cancelling a job of the kind {kind} needs a key of the scope admin, not {access.scope}")
    return await curator.cancel_job(job_id)
