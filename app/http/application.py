"""The application: middleware around routes around use-cases."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from fastapi import FastAPI

from app.http import problems
from app.http.dependencies import once_each
from app.http.metrics import Metrics
from app.http.middleware import BodyLimit, ReadinessGate, RequestContext
from app.http.openapi import document
from app.http.routes import enroll, health, images, jobs, maps, places, query, views
from app.http.service import Service
from app.version import VERSION
from schemas.settings import MEGA

if TYPE_CHECKING:
    from worker.runtime import Runtime

TAGS = [
    {"name": "enrol and query", "description": "What revisit is for."},
    {"name": "views", "description": "Enrolled images and what was said about them."},
    {"name": "images", "description": "Views, drawn or as enrolled."},
    {"name": "maps", "description": "Named sets of views that are searched together."},
    {"name": "jobs", "description": "Work in the background."},
    {"name": "service", "description": "How the service is."},
]


def create_app(runtime: "Runtime") -> FastAPI:
    """The application around a runtime that was built and not yet started: both start and stop together."""
    return application(Service.of(runtime))


def application(service: Service) -> FastAPI:
    """An application that starts and stops the service with itself."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await service.lifecycle.start()
        try:
            yield
        finally:
            await service.lifecycle.stop()

    app = FastAPI(
        title="revisit",
        version=VERSION,
        lifespan=lifespan,
        openapi_tags=TAGS,
        # FastAPI's pages load their scripts from elsewhere; ours are in app.console.pages.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.service = service
    app.state.metrics = metrics = Metrics()
    for room in (enroll, query):
        app.include_router(room.router)
    for room in (views, images, maps, places, jobs, health):
        app.include_router(room.router, dependencies=[once_each])
    app.openapi = lambda: document(app)  # type: ignore[method-assign]
    problems.install(app)
    # Added last is outermost: every answer passes RequestContext, and a body is read once the gate and the limit agree.
    app.add_middleware(BodyLimit, max_bytes=round(service.settings.max_body_mb * MEGA))
    app.add_middleware(ReadinessGate, state=lambda: (service.lifecycle.started, service.lifecycle.draining))
    app.add_middleware(RequestContext, metrics=metrics)
    return app
