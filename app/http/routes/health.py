"""Health, metrics, version, and the pages for people.

`/livez` and `/readyz` run on the event loop and never wait for a thread of the pool, so they answer while all are busy.
"""

import asyncio
from collections.abc import Awaitable

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from app.console import pages
from app.http.dependencies import Lifecycles, Measures, checked, no_parameters
from app.http.keys import Accesses
from app.http.metrics import MEDIA_TYPE
from app.http.middleware import STARTING_RETRY_S
from app.http.openapi import answers_bytes, document, refusals
from app.http.readiness import liveness
from schemas.keys import Access
from schemas.wire import Readiness, Version

router = APIRouter(tags=["service"], dependencies=[*checked, no_parameters])

_OF_MAP = "map "

PATIENCE_S = 0.2
"""Seconds to wait for a check, twice: `/readyz` answers within half a second."""


@router.get(
    "/livez",
    responses={
        **answers_bytes("text/plain", description="Alive."),
        503: {"content": {"text/plain": {}}, "description": "Only a restart helps; the text says why."},
        **refusals(always_open=True),
    },
)
async def livez(lifecycle: Lifecycles) -> Response:
    """Whether the process answers, and a restart would not help.

    It would where the encoder has failed on every image for a minute or been at one for ten, or a thread has ended that
    describes them.
    """
    return liveness(lifecycle.beyond_help())


@router.get(
    "/readyz",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "Not ready; `checks` says why."}, **refusals(always_open=True)},
)
async def readyz(lifecycle: Lifecycles, access: Accesses) -> Response:
    """Whether the service can enrol and answer queries now; `checks` says what cannot and why."""
    if lifecycle.draining or not lifecycle.started:
        state = "stopping" if lifecycle.draining else "starting"
        readiness = Readiness(ready=False, checks={"service": state})
    else:
        readiness = await _in_time(lifecycle.readiness())
    readiness = _shown(readiness, access)
    headers = {} if readiness.ready else {"Retry-After": str(STARTING_RETRY_S)}
    return JSONResponse(readiness.model_dump(mode="json"), 200 if readiness.ready else 503, headers)


@router.get(
    "/metrics",
    response_class=Response,
    responses={**answers_bytes("text/plain", description="Prometheus's text format."), **refusals(always_open=True)},
)
async def metrics(lifecycle: Lifecycles, measures: Measures) -> Response:
    """Metrics in Prometheus's text format; what is read from the database may be some seconds old."""
    gauges = measures.statistics
    gauges.state = "draining" if lifecycle.draining else "ready" if lifecycle.started else "starting"
    gauges.version = await lifecycle.version()
    gauges.live = lifecycle.live()
    if lifecycle.started and not lifecycle.draining:
        gauges.statistics, gauges.age_s = await lifecycle.statistics()
    return Response(measures.text(), media_type=MEDIA_TYPE)


@router.get("/version", response_model=Version, responses=refusals())
async def version(lifecycle: Lifecycles) -> Version:
    """Versions: service, encoder, weights, libraries."""
    return await lifecycle.version()


@router.get("/openapi.json", include_in_schema=False)
async def openapi(request: Request) -> Response:
    """The OpenAPI document."""
    return JSONResponse(document(request.app))


@router.get("/docs", response_class=HTMLResponse, include_in_schema=False)
async def docs(request: Request) -> Response:
    """API documentation: one page that loads nothing from other hosts."""
    return _page(pages.docs(document(request.app), request.url.netloc))


async def _in_time(looking: Awaitable[Readiness]) -> Readiness:
    """What was found; not ready where there is no answer.

    It waits twice: where the event loop was late itself, the first time is over before anything could be found.
    """
    found = asyncio.ensure_future(looking)
    for _ in range(2):
        await asyncio.wait([found], timeout=PATIENCE_S)
        if found.done():
            return found.result()
    found.cancel()
    return Readiness(ready=False, checks={"service": f"no answer within {2 * PATIENCE_S * 1000:.0f} ms"})


def _shown(readiness: Readiness, access: Access) -> Readiness:
    """The checks without the names of maps that the caller may not use."""
    known = {
        name: state
        for name, state in readiness.checks.items()
        if not name.startswith(_OF_MAP) or access.may_use(name.removeprefix(_OF_MAP))
    }
    hidden = len(readiness.checks) - len(known)
    if hidden:
        known["maps"] = f"{hidden} cannot be served; with a key for them this says which and why"
    maps = {name: state for name, state in readiness.maps.items() if access.may_use(name)}
    return readiness.model_copy(update={"checks": known, "maps": maps})


def _page(html: str) -> Response:
    return HTMLResponse(html, headers={"Content-Security-Policy": pages.POLICY})
