"""`/jobs`: work in the background."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.http.dependencies import Curates, JobId, no_parameters
from app.http.keys import Accesses, check_map
from app.http.openapi import refusals
from app.http.parameters import ListJobs
from schemas.wire import Job, Jobs

router = APIRouter(tags=["jobs"])


@router.get("/jobs", response_model=Jobs, responses=refusals("not-found"))
async def list_jobs(params: Annotated[ListJobs, Query()], curator: Curates, access: Accesses) -> Jobs:
    """A page of jobs, newest first."""
    check_map(access, params.map)
    return await curator.jobs(
        params.map,
        kind=params.kind,
        state=params.state,
        cursor=params.cursor,
        limit=params.limit,
        among=access.maps,
    )


@router.get("/jobs/{job_id}", response_model=Job, dependencies=[no_parameters], responses=refusals("not-found"))
async def get_job(job_id: JobId, curator: Curates) -> Job:
    """One job: kind, state, progress, result or failure."""
    return await curator.job(job_id)


@router.delete(
    "/jobs/{job_id}",
    response_model=Job,
    dependencies=[no_parameters],
    responses=refusals("not-found", "conflict"),
)
async def cancel_job(job_id: JobId, curator: Curates) -> Job:
    """Cancel a describe job that is waiting, or a recipe or vocabulary job that has not finished."""
    return await curator.cancel_job(job_id)
