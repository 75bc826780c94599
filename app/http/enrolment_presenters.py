"""Results of enrolling, as they are sent."""

from app.http.presenters import view
from schemas import wire
from worker.service.enroll import Enrolled


def enrolled(outcome: Enrolled) -> wire.Enrolled:
    """The result of enrolling one image."""
    poor = [wire.EnrolmentWarning(code="poor-picture", detail=outcome.problem)] if outcome.problem else []
    alike = [wire.EnrolmentWarning(code=one.code, detail=one.detail, view=one.view) for one in outcome.resembles]
    return wire.Enrolled(
        view=view(outcome.view, outcome.labels),
        created=outcome.created,
        revision=outcome.revision,
        job=outcome.job_id,
        warnings=[*poor, *alike],
        timing_ms=outcome.timing_ms,
    )
