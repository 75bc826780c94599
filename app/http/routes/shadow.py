"""`/maps/{map}/shadow`: a recipe beside that of a map: shown, switched to, discarded."""

from fastapi import APIRouter
from fastapi.responses import Response

from app.http.dependencies import Curates, MapName, checked, no_parameters
from app.http.openapi import refusals
from app.http.started import STARTED, started
from schemas.wire import Job, Shadow

router = APIRouter(tags=["maps"], dependencies=[*checked, no_parameters])


@router.get("/maps/{map}/shadow", response_model=Shadow, responses=refusals("not-found"))
async def get_shadow(name: MapName, curator: Curates) -> Shadow:
    """The shadow of a map, begun by `POST /maps/{map}/recipe`; its table when it is ready."""
    return await curator.shadow(name)


@router.post(
    "/maps/{map}/shadow/switch",
    status_code=202,
    response_model=Job,
    responses={**STARTED, **refusals("not-found", "conflict", "disk-full")},
)
async def switch_to_shadow(name: MapName, curator: Curates) -> Response:
    """Change a map over to its shadow, in one transaction.

    The job is done at once, but for views that were enrolled a moment ago: it waits until they are described too.
    """
    return started(await curator.switch_to_shadow(name))


@router.delete("/maps/{map}/shadow", response_model=Job, responses=refusals("not-found", "disk-full"))
async def discard_shadow(name: MapName, curator: Curates) -> Job:
    """Discard the shadow of a map, ready or not: the map keeps its recipe. Answers the shadow's job."""
    return await curator.discard_shadow(name)
