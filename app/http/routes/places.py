"""`GET /places`: the user's own names for spots."""

from typing import Annotated

from fastapi import APIRouter, Depends

from app.http.dependencies import Curates, in_url
from app.http.openapi import asks, refusals
from app.http.parameters import ListPlaces
from schemas.wire import Places

router = APIRouter(tags=["maps"])


@router.get("/places", response_model=Places, openapi_extra=asks(ListPlaces), responses=refusals("not-found"))
async def list_places(params: Annotated[ListPlaces, Depends(in_url(ListPlaces))], curator: Curates) -> Places:
    """A page of places, by map and name."""
    return await curator.places(params.map, params.cursor, params.limit)
