"""Use-cases for recipes of maps, and for the shadows that try them."""

import asyncio
from typing import TYPE_CHECKING

from app.http import presenters
from schemas import wire
from schemas.requests import PostRecipe, PutMap
from schemas.shadow import ShadowRecord
from worker.description.presets import Wanted

if TYPE_CHECKING:
    from worker.runtime.services import Services


class RecipeCuration:
    """The part of `app.http.curate.Curator` that describes maps anew."""

    _services: "Services"

    async def switch_recipe(self, name: str, wanted: PostRecipe) -> wire.Job:
        """Describe a map's views by another recipe, in the background; with a shadow, until the map is told."""
        maps = self._services.maps
        if wanted.shadow is None:
            return presenters.job(await asyncio.to_thread(maps.switch_recipe, name, wanted_of(wanted)))
        return presenters.job(await asyncio.to_thread(maps.begin_shadow, name, wanted_of(wanted), wanted.shadow))

    async def shadow(self, name: str) -> wire.Shadow:
        """The shadow of a map."""
        return shadow(await asyncio.to_thread(self._services.shadows.of, name))

    async def switch_to_shadow(self, name: str) -> wire.Job:
        """Change a map over to its shadow."""
        return presenters.job(await asyncio.to_thread(self._services.shadows.switch, name))

    async def discard_shadow(self, name: str) -> wire.Job:
        """Discard the shadow of a map."""
        return presenters.job(await asyncio.to_thread(self._services.shadows.discard, name))


def wanted_of(put: PutMap) -> Wanted:
    """What is wanted of a recipe, from the body of a request."""
    return Wanted(put.labels, put.dynamic, put.preset, put.parameters, put.ranking)


def shadow(record: ShadowRecord) -> wire.Shadow:
    """A shadow."""
    job, path = presenters.job(record.job), f"/maps/{record.map}"
    recipe, ranking = record.recipe.description, record.recipe.ranking
    ready = record.state == "ready"
    links = {"self": f"{path}/shadow", "map": path, "job": f"/jobs/{job.id}"}
    if ready:
        links["switch"] = f"{path}/shadow/switch"
    return wire.Shadow(
        map=record.map,
        state=record.state,
        job=job.id,
        progress=job.progress,
        wanted=record.wanted,
        recipe={"id": recipe.id, **recipe.model_dump(mode="json")},
        ranking={"id": ranking.id, **ranking.model_dump(mode="json")},
        table=wire.ShadowTable.model_validate(job.result) if ready else None,
        links=links,
    )
