"""`GET /places`: the user's own names, each shared by some views."""

from typing import Annotated

from fastapi import APIRouter, Query

from app.http.dependencies import Curates, checked
from app.http.keys import Accesses, check_map
from app.http.openapi import refusals
from app.http.parameters import ListPlaces
from schemas.wire import Places

router = APIRouter(tags=["maps"], dependencies=checked)


@router.get("/places", response_model=Places, responses=refusals("not-found"))
async def list_places(params: Annotated[ListPlaces, Query()], curator: Curates, access: Accesses) -> Places:
    """A page of places, by map and name."""
    check_map(access, params.map)
    return await curator.places(params.map, params.cursor, params.limit, access.maps)
