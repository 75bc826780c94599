"""`/jobs`: work in the background."""

from fastapi import APIRouter

from app.http.dependencies import Curates, no_parameters
from app.http.openapi import refusals
from schemas.wire import Job

router = APIRouter(tags=["jobs"], dependencies=[no_parameters])


@router.get("/jobs/{job_id}", response_model=Job, responses=refusals("not-found"))
async def get_job(job_id: str, curator: Curates) -> Job:
    """One job: what it does, and how far it is."""
    return await curator.job(job_id)


@router.delete("/jobs/{job_id}", response_model=Job, responses=refusals("not-found", "conflict"))
async def cancel_job(job_id: str, curator: Curates) -> Job:
    """Cancel a job that is waiting."""
    return await curator.cancel_job(job_id)
