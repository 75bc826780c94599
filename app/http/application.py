"""The FastAPI application: middleware, routes, and the use-cases that the routes call."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from fastapi import FastAPI

from app.http import problems
from app.http.addresses import Addresses
from app.http.cors import cors
from app.http.job_events import Followers
from app.http.keys import KeyGate
from app.http.metrics import Metrics
from app.http.middleware import BodyLimit, Failures, ReadinessGate, RequestContext
from app.http.openapi import document
from app.http.other_sites import OtherSites
from app.http.rate_limits import RateLimit
from app.http.routes import (
    changes,
    compreface,
    console,
    enroll,
    health,
    images,
    imports,
    jobs,
    localize,
    map_health,
    maps,
    places,
    proposals,
    query,
    shadow,
    snapshots,
    unknown,
    views,
)
from app.http.service import Service
from app.http.tracing import Tracing, finish, make_provider
from app.version import VERSION

if TYPE_CHECKING:
    from worker.runtime import Runtime

TAGS = [
    {"name": "enrol and query", "description": "Keep images of places; recognise places in images."},
    {"name": "views", "description": "Enrolled images and their attributes."},
    {"name": "images", "description": "Images of views: as enrolled, small, and as drawings."},
    {"name": "maps", "description": "Named sets of views that are searched together."},
    {"name": "jobs", "description": "Work in the background: describing, recipes, vocabularies, imports."},
    {"name": "snapshots", "description": "Maps as files: made, given away, restored."},
    {"name": "compatible services", "description": "The shapes of other services, for apps that speak to them."},
    {"name": "service", "description": "Health, metrics and version."},
]

_OF_MAPS = (views, images, changes, maps, shadow, imports, map_health, unknown, proposals, places, jobs, snapshots)
_ROUTERS = (
    enroll.router,
    query.router,
    maps.previews,
    *(group.router for group in (localize, *_OF_MAPS, compreface, health, console)),
)
"""In the order in which their routes are tried."""


def create_app(runtime: "Runtime") -> FastAPI:
    """The application of a runtime that is built but not started; they start and stop together."""
    return application(Service.of(runtime))


def application(service: Service, tracer_provider: Any = None) -> FastAPI:
    """The application of a service; the service starts and stops with it.

    Parameters
    ----------
    service : Service
    tracer_provider : TracerProvider, optional
        Of OpenTelemetry; None makes one if the settings ask for traces.
    """
    if tracer_provider is None and service.settings.traces:
        tracer_provider = make_provider()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await service.lifecycle.start()
        for teller in service.tellers:
            teller.start()
        try:
            yield
        finally:
            await service.lifecycle.stop()
            await asyncio.gather(*(asyncio.to_thread(teller.close) for teller in service.tellers))
            if tracer_provider is not None:  # sends what is left
                await asyncio.to_thread(finish, tracer_provider)

    app = FastAPI(
        title="revisit",
        version=VERSION,
        lifespan=lifespan,
        openapi_tags=TAGS,
        # As they are: routers that are included are made anew, for each application and by its first request.
        routes=[route for router in _ROUTERS for route in router.routes],
        # FastAPI's pages load scripts from other hosts; `app.console.pages` has pages of our own.
        docs_url=None,
        redoc_url=None,
        openapi_url=None,  # `app.http.routes.health` answers it, and refuses parameters
        redirect_slashes=False,
    )
    app.state.service = service
    app.state.followers = Followers()
    app.state.metrics = metrics = Metrics()
    metrics.statistics.settings = service.settings
    for teller in service.tellers:
        teller.on_outcome(partial(metrics.event, teller.name))
    app.openapi = lambda: document(app)  # type: ignore[method-assign]
    problems.install(app)
    _add_middleware(app, service, metrics, tracer_provider)
    return app


def _add_middleware(app: FastAPI, service: Service, metrics: Metrics, tracer_provider: Any) -> None:
    """Add what each request passes through.

    What is added last is outermost: RequestContext sees every answer, and no body is read before ReadinessGate,
    KeyGate, OtherSites, RateLimit and BodyLimit let the request through.
    """
    app.add_middleware(BodyLimit, settings=service.settings)
    app.add_middleware(RateLimit, settings=service.settings)
    app.add_middleware(OtherSites, origins=service.settings.cors_origins, any_name=service.settings.open)
    app.add_middleware(KeyGate, keys=service.keys)
    app.add_middleware(ReadinessGate, state=lambda: (service.lifecycle.started, service.lifecycle.draining))
    if tracer_provider is not None:
        app.add_middleware(Tracing, provider=tracer_provider, metrics=metrics)
    app.add_middleware(Addresses)
    if service.settings.cors_origins:
        app.add_middleware(Failures)
        app.add_middleware(cors, origins=service.settings.cors_origins)
    app.add_middleware(
        RequestContext,
        metrics=metrics,
        draining=lambda: service.lifecycle.draining,
        slow_s=service.settings.slow_s,
    )
