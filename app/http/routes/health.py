"""Health, metrics, version, and the pages for people.

`/livez` and `/readyz` run on the event loop and never wait for a thread of the pool, so they answer while all are busy.
"""

import asyncio

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response

from app.console import pages
from app.http.curate import Curator
from app.http.dependencies import Curates, Lifecycles, Measures, no_parameters
from app.http.lifecycle import Lifecycle
from app.http.metrics import MEDIA_TYPE
from app.http.middleware import STARTING_RETRY_S
from app.http.openapi import answers_bytes, document, refusals
from schemas.errors import RevisitError
from schemas.wire import Maps, Readiness, Version

router = APIRouter(tags=["service"], dependencies=[no_parameters])

PATIENCE_S = 0.4
"""Seconds to wait for a check; `/readyz` answers within half a second."""


@router.get("/livez", responses={**answers_bytes("text/plain", description="Alive."), **refusals(always_open=True)})
async def livez() -> Response:
    """Whether the process answers."""
    return Response("ok\n", media_type="text/plain")


@router.get(
    "/readyz",
    response_model=Readiness,
    responses={503: {"model": Readiness, "description": "Not ready; `checks` says why."}, **refusals(always_open=True)},
)
async def readyz(lifecycle: Lifecycles) -> Response:
    """Whether the service can enrol and answer queries now; `checks` says what cannot and why."""
    if lifecycle.draining or not lifecycle.started:
        state = "stopping" if lifecycle.draining else "starting"
        readiness = Readiness(ready=False, checks={"service": state})
    else:
        try:
            readiness = await asyncio.wait_for(lifecycle.readiness(), PATIENCE_S)
        except TimeoutError:
            readiness = Readiness(ready=False, checks={"service": f"no answer within {PATIENCE_S * 1000:.0f} ms"})
    headers = {} if readiness.ready else {"Retry-After": str(STARTING_RETRY_S)}
    return JSONResponse(readiness.model_dump(mode="json"), 200 if readiness.ready else 503, headers)


@router.get(
    "/metrics",
    response_class=Response,
    responses={**answers_bytes("text/plain", description="Prometheus's text format."), **refusals(always_open=True)},
)
async def metrics(lifecycle: Lifecycles, curator: Curates, measures: Measures) -> Response:
    """Metrics in Prometheus's text format."""
    maps = await _maps(lifecycle, curator)
    if maps is not None:
        measures.state(await lifecycle.queue_length(), maps.maps)
    return Response(measures.text(), media_type=MEDIA_TYPE)


@router.get("/version", response_model=Version, responses=refusals())
async def version(lifecycle: Lifecycles) -> Version:
    """Versions: service, encoder, weights, libraries."""
    return await lifecycle.version()


@router.api_route("/openapi.json", methods=["GET", "HEAD"], include_in_schema=False)
async def openapi(request: Request) -> Response:
    """The OpenAPI document."""
    return JSONResponse(document(request.app))


@router.get("/docs", response_class=HTMLResponse, include_in_schema=False)
async def docs(request: Request) -> Response:
    """API documentation: one page that loads nothing from other hosts."""
    return _page(pages.docs(document(request.app)))


@router.get("/", response_class=HTMLResponse, include_in_schema=False)
async def console(request: Request, lifecycle: Lifecycles, curator: Curates) -> Response:
    """The console: the maps, and links to everything else."""
    return _page(pages.console(request.app.version, await _maps(lifecycle, curator)))


async def _maps(lifecycle: Lifecycle, curator: Curator) -> Maps | None:
    """All maps, or None when the store does not answer within `PATIENCE_S`, so that no page hangs."""
    if not lifecycle.started:
        return None
    try:
        return await asyncio.wait_for(curator.maps(), PATIENCE_S)
    except (TimeoutError, RevisitError):
        return None


def _page(html: str) -> Response:
    return HTMLResponse(html, headers={"Content-Security-Policy": pages.POLICY})
