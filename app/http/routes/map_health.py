"""`GET /maps/{map}/health`: what a map lacks or suffers from."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.http.dependencies import Curates, MapName, checked
from app.http.examples import MAP_HEALTH
from app.http.openapi import refusals
from app.http.parameters import HealthParameters
from schemas.wire import MapHealth

router = APIRouter(tags=["maps"], dependencies=checked)


@router.get(
    "/maps/{map}/health",
    response_model=MapHealth,
    responses={200: {"content": {"application/json": {"example": MAP_HEALTH}}}, **refusals("not-found")},
)
async def map_health(name: MapName, params: Annotated[HealthParameters, Query()], curator: Curates) -> MapHealth:
    """What makes the map's answers wrong or missing, and what to do: twins, duplicates, thin coverage.

    Computed from what is stored when it is first asked for at a revision; twins become known as the map is queried with
    its own views in the background (`compared`).
    """
    return await curator.health(name, params.code, params.limit)
