"""The application: middleware around routes around use-cases."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Protocol

from fastapi import FastAPI

from app import problems
from app.metrics import Metrics
from app.middleware import BodyLimit, Door, Entrance
from app.openapi import document
from app.recognise import Recogniser
from app.routes import enroll, health, jobs, maps, pictures, places, query, views
from schemas.settings import MEGA, Settings

VERSION = "0.1.0"

TAGS = [
    {"name": "enrol and ask", "description": "The two questions revisit is for."},
    {"name": "views", "description": "Enrolled pictures and what was said about them."},
    {"name": "pictures", "description": "Views as pictures."},
    {"name": "maps", "description": "Named sets of views that are searched together."},
    {"name": "jobs", "description": "Work in the background."},
    {"name": "service", "description": "How the service is."},
]


class House(Protocol):
    """What the application is built around."""

    @property
    def settings(self) -> Settings:
        """Limits on bodies."""
        ...

    @property
    def recogniser(self) -> Recogniser:
        """The use-cases."""
        ...

    async def start(self) -> None:
        """Open the store, load the encoder, begin to work; raises SetupError."""
        ...

    async def stop(self) -> None:
        """Finish what is in hand and let go of everything."""
        ...


def create_app(house: House) -> FastAPI:
    """An application that starts and stops the house with itself."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await house.start()
        try:
            yield
        finally:
            await house.stop()

    app = FastAPI(
        title="revisit",
        version=VERSION,
        lifespan=lifespan,
        openapi_tags=TAGS,
        # FastAPI's pages load their scripts from elsewhere; ours are in app.pages.
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.recogniser = house.recogniser
    app.state.metrics = metrics = Metrics()
    app.state.patching = asyncio.Lock()
    for room in (enroll, query, views, pictures, maps, places, jobs, health):
        app.include_router(room.router)
    app.openapi = lambda: document(app)  # type: ignore[method-assign]
    problems.install(app)
    # Added last is outermost: every answer passes Entrance, and a body is not read before Door and BodyLimit agree.
    app.add_middleware(BodyLimit, max_bytes=round(house.settings.max_body_mb * MEGA))
    app.add_middleware(Door, state=lambda: (house.recogniser.started, house.recogniser.draining))
    app.add_middleware(Entrance, metrics=metrics)
    return app
